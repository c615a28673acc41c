#include "joint_stop.hpp"

#include <algorithm>
#include <cmath>

namespace s2r {

VelocityProfile::VelocityProfile(double v, double a, double v_end, double a_max, double j_max) noexcept
    : v_(v), a_(a), v_end_(v_end) {
  // Mirror so that, after the present acceleration has been unwound, velocity still has to rise.
  const double v_unwound = v + a * std::abs(a) / (2.0 * j_max);
  const double side = v_unwound <= v_end ? 1.0 : -1.0;
  const double a0 = side * a, dv = side * (v_end - v);

  const double peak = std::min(a_max, std::sqrt(std::max(0.0, j_max * dv + 0.5 * a0 * a0)));
  const double unwind = peak / j_max;
  const double build = (peak - a0) / j_max;  // negative: the start is above the peak
  const double gained = 0.5 * (a0 + peak) * std::abs(build) + 0.5 * peak * unwind;
  const double hold = peak > 0.0 ? std::max(0.0, (dv - gained) / peak) : 0.0;

  phase_duration_ = {std::abs(build), hold, unwind};
  phase_jerk_ = {side * (build < 0.0 ? -j_max : j_max), 0.0, -side * j_max};
  duration_ = phase_duration_[0] + phase_duration_[1] + phase_duration_[2];
}

Motion1 VelocityProfile::at(double t) const noexcept {
  Motion1 m{.v = v_, .a = a_};
  double left = std::clamp(t, 0.0, duration_);
  for (std::size_t i = 0; i < 3; ++i) {
    const double h = std::min(left, phase_duration_[i]);
    const double j = phase_jerk_[i];
    m = {m.p + h * (m.v + h * (m.a / 2.0 + h * j / 6.0)), m.v + h * (m.a + h * j / 2.0), m.a + h * j, j};
    left -= h;
    if (left <= 0.0) break;
  }
  if (t >= duration_) m = {m.p + (t - duration_) * v_end_, v_end_, 0.0, 0.0};  // exact, free of rounding
  return m;
}

void JointStop::begin(const Reference& from, const Limits& limits, int dof) noexcept {
  q_start_ = from.q;
  dof_ = dof;
  duration_ = 0.0;
  for (int joint = 0; joint < dof; ++joint) {
    profiles_[joint] =
        VelocityProfile(from.dq[joint], from.ddq[joint], 0.0, limits.ddq_max[joint], limits.dddq_max[joint]);
    duration_ = std::max(duration_, profiles_[joint].duration());
  }
}

Reference JointStop::at(double t) const noexcept {
  Reference out;
  for (int joint = 0; joint < dof_; ++joint) {
    const Motion1 m = profiles_[joint].at(t);
    out.q[joint] = q_start_[joint] + m.p;
    out.dq[joint] = m.v;
    out.ddq[joint] = m.a;
  }
  return out;
}

}  // namespace s2r
