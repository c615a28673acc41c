#include "gate.hpp"

#include <cmath>

namespace s2r {

void Gate::configure(const Limits& limits, int dof, double dt, double margin) noexcept {
  limits_ = limits;
  dof_ = dof;
  dt_ = dt;
  margin_ = margin;
}

void Gate::reset(const EncodedSetpoint& at_rest) noexcept { sent_.fill(at_rest); }

void Gate::commit(const EncodedSetpoint& sent) noexcept { sent_ = {sent, sent_[0], sent_[1]}; }

Trip Gate::check(const EncodedSetpoint& next) const noexcept {
  for (int joint = 0; joint < dof_; ++joint)
    if (const Trip trip = check_joint(joint, next[joint])) return trip;
  return {};
}

// Every bound is written !(x <= bound) so that a NaN in a limit or a value trips too. Rounding each position to a
// count moves an n-th difference by at most 2^n / 2 counts; that, and no more, is added to the bounds.
Trip Gate::check_joint(int joint, const EncodedJoint& next) const noexcept {
  if (!next.ok) return {Cause::kLimitPosition, joint, kNan, limits_.q_max[joint]};
  const double unit = kRadPerCount, half = 0.51 * kRadPerCount;
  const double q = decode_position(next.position);
  if (!(q >= limits_.q_min[joint] - half)) return {Cause::kLimitPosition, joint, q, limits_.q_min[joint]};
  if (!(q <= limits_.q_max[joint] + half)) return {Cause::kLimitPosition, joint, q, limits_.q_max[joint]};

  const double p0 = next.position, p1 = sent_[0][joint].position;  // int32 is exact in a double
  const double p2 = sent_[1][joint].position, p3 = sent_[2][joint].position;
  const double v = (p0 - p1) * unit / dt_;
  const double a = (p0 - 2 * p1 + p2) * unit / (dt_ * dt_);
  const double j = (p0 - 3 * p1 + 3 * p2 - p3) * unit / (dt_ * dt_ * dt_);
  const double v_max = limits_.dq_max[joint], a_max = limits_.ddq_max[joint], j_max = limits_.dddq_max[joint];
  if (!(std::abs(v) <= margin_ * v_max + unit / dt_)) return {Cause::kLimitVelocity, joint, v, v_max};
  const double v_field = decode_velocity(next.velocity);
  if (!(std::abs(v_field) <= margin_ * v_max + 0.5 * kRadPerSecondPerCount))
    return {Cause::kLimitVelocity, joint, v_field, v_max};
  if (!(std::abs(a) <= margin_ * a_max + 2 * unit / (dt_ * dt_))) return {Cause::kLimitAcceleration, joint, a, a_max};
  if (!(std::abs(j) <= margin_ * j_max + 4 * unit / (dt_ * dt_ * dt_))) return {Cause::kLimitJerk, joint, j, j_max};
  return {};
}

}  // namespace s2r
