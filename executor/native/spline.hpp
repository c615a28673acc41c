// Quintic Hermite segments: position, velocity and acceleration given at both ends of every segment.
#pragma once

#include <array>

#include "types.hpp"

namespace s2r {

struct Motion1 {  // one joint: position and its first three derivatives
  double p = 0.0, v = 0.0, a = 0.0, j = 0.0;
};

// p(t) for t in [0, duration] as a polynomial in x = t / duration.
class Quintic {
 public:
  Quintic() = default;
  static Quintic hermite(double duration, const Motion1& start, const Motion1& end) noexcept;
  Motion1 at(double t) const noexcept;

 private:
  std::array<double, 6> c_{};
  double duration_ = 1.0;
};

// All joints of a plan at path time s; jerk is per path time as well.
struct PathPoint {
  Joints q{}, dq{}, ddq{}, dddq{};
};

// Reads a plan at rising path times; remembers the segment so that a tick costs no search.
class PlanCursor {
 public:
  void open(const Plan& plan) noexcept;
  PathPoint at(double s) noexcept;
  // Longest stop_duration of the segments that [s_from, s_to] touches [s].
  double stop_duration(double s_from, double s_to) const noexcept;
  // Expected torque at path time s and rate r, linear between knots [N m]; only for plans that have it.
  Joints torque(double s, double rate) const noexcept;
  const Plan* plan() const noexcept { return plan_; }

 private:
  int find(double s) const noexcept;
  void load(int segment) noexcept;

  const Plan* plan_ = nullptr;
  int segment_ = -1;
  PerJoint<Quintic> joints_{};
};

}  // namespace s2r
