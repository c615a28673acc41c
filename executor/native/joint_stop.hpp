// Jerk-limited change of velocity in closed form, and the joint-space stop built from it.
//
// Time-optimal for |a| <= a_max, |j| <= j_max from any (v, a) to (v_end, 0): unwind or build up the acceleration,
// hold it, unwind it. Ruckig's velocity interface gives the same profile; a test compares them.
#pragma once

#include <array>

#include "spline.hpp"
#include "types.hpp"

namespace s2r {

class VelocityProfile {
 public:
  VelocityProfile() = default;
  // a_max and j_max > 0. |a| may start above a_max: it is brought down first.
  VelocityProfile(double v, double a, double v_end, double a_max, double j_max) noexcept;

  double duration() const noexcept { return duration_; }
  // p is the distance since the start.
  Motion1 at(double t) const noexcept;
  double distance() const noexcept { return at(duration_).p; }

 private:
  std::array<double, 3> phase_duration_{};
  std::array<double, 3> phase_jerk_{};
  double v_ = 0.0, a_ = 0.0, v_end_ = 0.0;
  double duration_ = 0.0;
};

// Brings every joint to rest on its own, from the commanded state. Leaves the planned path.
class JointStop {
 public:
  void begin(const Reference& from, const Limits& limits, int dof) noexcept;
  Reference at(double t) const noexcept;
  double duration() const noexcept { return duration_; }
  double duration(int joint) const noexcept { return profiles_[joint].duration(); }

 private:
  PerJoint<VelocityProfile> profiles_{};
  Joints q_start_{};
  int dof_ = 0;
  double duration_ = 0.0;
};

}  // namespace s2r
