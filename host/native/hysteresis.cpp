#include "hysteresis.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>

namespace s2r::gap {
namespace {

constexpr double kLongest = 0.2;  // of the width, per part of a step
constexpr int kMostParts = 20;

}  // namespace

std::vector<double> held_slip(const double* step, int rows) {
  std::vector<double> found(static_cast<std::size_t>(rows));
  double z = 0.0;
  for (int i = 0; i < rows; ++i) found[static_cast<std::size_t>(i)] = z = std::clamp(z + step[i], -1.0, 1.0);
  return found;
}

std::vector<double> hysteresis_loop(const double* step, int rows, double width, double power, double beta) {
  std::vector<double> found(static_cast<std::size_t>(rows));
  const double limit = kLongest * width, back = 2.0 * beta - 1.0;
  double z = 0.0;
  for (int i = 0; i < rows; ++i) {
    const double dq = step[i], many = std::abs(dq) / limit;
    const int parts = std::abs(dq) < limit ? 1 : many < kMostParts - 1 ? static_cast<int>(many) + 1 : kMostParts;
    const double x = dq / parts / width;
    for (int part = 0; part < parts; ++part) {
      const double size = std::pow(std::abs(z), power);
      z = std::clamp(z + x * (z * dq > 0.0 ? 1.0 - size : 1.0 + back * size), -1.0, 1.0);
    }
    found[static_cast<std::size_t>(i)] = z;
  }
  return found;
}

}  // namespace s2r::gap
