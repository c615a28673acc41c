#include "plan_check.hpp"

#include <cmath>

namespace s2r {
namespace {

constexpr double kRestVelocity = 1e-6, kRestAcceleration = 1e-4;

Refused check_times(const Plan& plan, double dt) noexcept {
  if (!(std::abs(plan.t[0]) <= 1e-12)) return {Refusal::kTime, -1, plan.t[0], 0.0};
  for (int i = 1; i < plan.knots; ++i) {
    const double step = plan.time(i) - plan.time(i - 1);
    if (!(step >= kMinSegment_s)) return {Refusal::kTime, -1, step, kMinSegment_s};
    const double stop = plan.stop_duration[static_cast<std::size_t>(i - 1)];
    if (!(stop >= dt)) return {Refusal::kNoStopPath, -1, stop, dt};
    if (!(stop <= kMaxStop_s)) return {Refusal::kNoStopPath, -1, stop, kMaxStop_s};
  }
  if (!(plan.duration() <= kMaxDuration_s)) return {Refusal::kTime, -1, plan.duration(), kMaxDuration_s};
  return {};
}

Refused check_knot(const Plan& plan, std::size_t i, const Config& config) noexcept {
  const Limits& limits = config.limits;
  for (int joint = 0; joint < plan.dof; ++joint) {
    const double q = plan.q[i][joint], dq = plan.dq[i][joint], ddq = plan.ddq[i][joint];
    if (!std::isfinite(q)) return {Refusal::kNonfinite, joint, q, 0.0};
    if (!std::isfinite(dq)) return {Refusal::kNonfinite, joint, dq, 0.0};
    if (!std::isfinite(ddq)) return {Refusal::kNonfinite, joint, ddq, 0.0};
    if (!(q >= limits.q_min[joint])) return {Refusal::kPosition, joint, q, limits.q_min[joint]};
    if (!(q <= limits.q_max[joint])) return {Refusal::kPosition, joint, q, limits.q_max[joint]};
    if (!(std::abs(dq) <= config.gate_margin * limits.dq_max[joint]))
      return {Refusal::kVelocity, joint, dq, limits.dq_max[joint]};
    if (plan.has_torque)
      for (const double tau : {plan.tau_rest[i][joint], plan.tau_move[i][joint]})
        if (!(std::abs(tau) <= limits.tau_max[joint])) return {Refusal::kTorque, joint, tau, limits.tau_max[joint]};
    if (!(std::abs(ddq) <= config.gate_margin * limits.ddq_max[joint]))
      return {Refusal::kAcceleration, joint, ddq, limits.ddq_max[joint]};
  }
  return {};
}

Refused check_rest(const Plan& plan, std::size_t i) noexcept {
  for (int joint = 0; joint < plan.dof; ++joint) {
    if (!(std::abs(plan.dq[i][joint]) <= kRestVelocity))
      return {Refusal::kNotAtRest, joint, plan.dq[i][joint], kRestVelocity};
    if (!(std::abs(plan.ddq[i][joint]) <= kRestAcceleration))
      return {Refusal::kNotAtRest, joint, plan.ddq[i][joint], kRestAcceleration};
  }
  return {};
}

}  // namespace

Refused check_plan(const Plan& plan, const Config& config) noexcept {
  if (plan.dof != config.dof) return {Refusal::kModel, -1, double(plan.dof), double(config.dof)};
  if (plan.knots < 2 || plan.knots > kMaxKnots) return {Refusal::kSize, -1, double(plan.knots), double(kMaxKnots)};
  const double dt = 1e-9 * static_cast<double>(config.tick_ns);
  if (const Refused refused = check_times(plan, dt)) return refused;
  for (int i = 0; i < plan.knots; ++i)
    if (const Refused refused = check_knot(plan, static_cast<std::size_t>(i), config)) return refused;
  for (const double tolerance : {plan.path_tolerance, plan.goal_tolerance})
    if (!(tolerance >= 0.0 && tolerance <= 1.0)) return {Refusal::kMalformed, -1, tolerance, 1.0};
  if (plan.parent_id == 0)
    if (const Refused refused = check_rest(plan, 0)) return refused;
  return check_rest(plan, static_cast<std::size_t>(plan.knots - 1));
}

}  // namespace s2r
