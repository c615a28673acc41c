#include "path_cells.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace s2r {
namespace {

constexpr int kMostCells = 20'000;

struct Cubic {
  double c0, c1, c2, c3;
  double at(double x) const noexcept { return c0 + x * (c1 + x * (c2 + x * c3)); }
};

struct Interval {
  double low = std::numeric_limits<double>::infinity(), high = -low;
  void take(double value) noexcept {
    low = std::min(low, value);
    high = std::max(high, value);
  }
};

// Over [a, b]: ends, and where the derivative is zero in between.
Interval range_of_jerk(const Cubic& ddq, double a, double b) noexcept {
  const Cubic jerk{ddq.c1, 2.0 * ddq.c2, 3.0 * ddq.c3, 0.0};
  Interval out;
  out.take(jerk.at(a));
  out.take(jerk.at(b));
  const double vertex = -jerk.c1 / (2.0 * jerk.c2);
  if (vertex > a && vertex < b) out.take(jerk.at(vertex));  // NaN and infinity are not inside
  return out;
}

Interval range_of_acceleration(const Cubic& ddq, const Interval& jerk, double a, double b) noexcept {
  Interval out;
  out.take(ddq.at(a));
  out.take(ddq.at(b));
  if (jerk.low >= 0.0 || jerk.high <= 0.0) return out;  // it only rises or falls
  const double A = 3.0 * ddq.c3, B = 2.0 * ddq.c2, C = ddq.c1;
  const double root = std::sqrt(std::max(0.0, B * B - 4.0 * A * C));
  const double s = -0.5 * (B + std::copysign(root, B));  // free of cancellation
  for (const double x : {s / A, C / s})
    if (x > a && x < b) out.take(ddq.at(x));
  return out;
}

void include(Band& band, std::size_t at, const Interval& values) noexcept {
  band.low[at] = std::min(band.low[at], values.low);
  band.high[at] = std::max(band.high[at], values.high);
}

// Each cell takes up the one `shift` cells ahead, before that one does.
void look_ahead(Band& band, std::size_t shift) noexcept {
  const std::size_t count = band.low.size() - std::min(shift, band.low.size());
  double *const low = band.low.data(), *const high = band.high.data();
  for (std::size_t i = 0; i < count; ++i) low[i] = std::min(low[i], low[i + shift]);
  for (std::size_t i = 0; i < count; ++i) high[i] = std::max(high[i], high[i + shift]);
}

}  // namespace

void PathCells::widen(int new_width) {
  while (width < new_width) {
    const int shift = std::min(width, new_width - width);
    for (Band* band : {&dq, &ddq, &dddq})
      look_ahead(*band, static_cast<std::size_t>(shift) * static_cast<std::size_t>(dof));
    width += shift;
  }
}

PathCells path_cells(const Polynomials& plan, double step_s) {
  const double duration = plan.knots[plan.segments] - plan.knots[0];
  PathCells out;
  out.dof = plan.dof;
  out.cells = static_cast<int>(std::clamp(std::ceil(duration / step_s), 1.0, static_cast<double>(kMostCells)));
  out.step_s = duration / out.cells;
  const auto dof = static_cast<std::size_t>(plan.dof), size = static_cast<std::size_t>(out.cells) * dof;
  const Interval empty;
  for (Band* band : {&out.dq, &out.ddq, &out.dddq}) {
    band->low.assign(size, empty.low);
    band->high.assign(size, empty.high);
  }
  for (int segment = 0; segment < plan.segments; ++segment) {
    const double start = plan.knots[segment] - plan.knots[0], end = plan.knots[segment + 1] - plan.knots[0];
    const int first = std::clamp(static_cast<int>(start / out.step_s), 0, out.cells - 1);
    const int last = std::clamp(static_cast<int>(end / out.step_s), 0, out.cells - 1);
    const double* const c = plan.coefficients + static_cast<std::size_t>(segment) * 6 * dof;
    for (int cell = first; cell <= last; ++cell) {
      const double a = std::max(start, cell * out.step_s) - start, b = std::min(end, (cell + 1) * out.step_s) - start;
      for (std::size_t joint = 0; joint < dof; ++joint) {
        const double c1 = c[dof + joint], c2 = c[2 * dof + joint], c3 = c[3 * dof + joint];
        const double c4 = c[4 * dof + joint], c5 = c[5 * dof + joint];
        const auto velocity = [&](double x) noexcept {
          return c1 + x * (2 * c2 + x * (3 * c3 + x * (4 * c4 + x * 5 * c5)));
        };
        const Cubic ddq{2 * c2, 6 * c3, 12 * c4, 20 * c5};
        const Interval jerk = range_of_jerk(ddq, a, b);
        // Off its chord a function is by no more than this.
        const double bend = (b - a) * (b - a) / 8.0 * std::max(std::abs(jerk.low), std::abs(jerk.high));
        Interval speed;
        speed.take(velocity(a));
        speed.take(velocity(b));
        const std::size_t at = static_cast<std::size_t>(cell) * dof + joint;
        include(out.dq, at, {speed.low - bend, speed.high + bend});
        include(out.ddq, at, range_of_acceleration(ddq, jerk, a, b));
        include(out.dddq, at, jerk);
      }
    }
  }
  return out;
}

}  // namespace s2r
