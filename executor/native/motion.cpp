#include "motion.hpp"

#include <algorithm>

namespace s2r {
namespace {

constexpr double kEnd_s = 1e-9;  // rounding of a sum of ticks: closer to an end or a splice than this is there

}  // namespace

void Motion::configure(const Limits& limits, int dof, double dt) noexcept {
  limits_ = limits;
  dof_ = dof;
  dt_ = dt;
}

void Motion::adopt(const Joints& q) noexcept {
  drop_plan();
  mode_ = Mode::kRest;
  reference_ = next_ = Reference{.q = q, .dq = {}, .ddq = {}};
}

void Motion::start(const Plan& plan, double rate) noexcept {
  plan_ = &plan;
  child_ = nullptr;
  cursor_.open(plan);
  ramp_.reset(rate);
  s_ = 0.0;
  mode_ = Mode::kPath;
  PathPoint left_over;
  for (int joint = 0; joint < dof_; ++joint) left_over.q[joint] = reference_.q[joint] - plan.q[0][joint];
  begin_fade(left_over);
}

void Motion::splice(const Plan& child) noexcept { child_ = &child; }

void Motion::drop_plan() noexcept {
  plan_ = child_ = nullptr;
  fade_t_ = kFadeDuration_s;
  mode_ = Mode::kRest;
  reference_.dq = reference_.ddq = {};
}

// Longest stop duration of the segments between here and s_to, those of a plan that takes over on the way included.
double Motion::stop_duration_until(double s_to) const noexcept {
  if (child_ == nullptr || s_to < child_->splice_t) return cursor_.stop_duration(s_, s_to);
  PlanCursor child;
  child.open(*child_);
  return std::max(cursor_.stop_duration(s_, child_->splice_t), child.stop_duration(0.0, s_to - child_->splice_t));
}

// From a steady rate to rest and back a segment's own duration holds for all that it covers of its plan. Any other
// change may reach into segments whose own is longer, of a plan that waits to take over as well: take the longest
// within reach.
double Motion::ramp_duration(double target) const noexcept {
  const bool to_rest = target == 0.0, from_rest = ramp_.rate() == 0.0;
  double duration = cursor_.stop_duration(s_, s_);
  const bool stays = child_ == nullptr || s_ + ramp_.distance_of_change(target, duration) < child_->splice_t;
  if (ramp_.steady() && (to_rest || from_rest) && stays) return duration;
  const double rate = std::max({ramp_.rate(), ramp_.target(), target});
  const int segments = plan_->knots + (child_ != nullptr ? child_->knots : 0);
  for (int i = 0; i < segments; ++i) {
    const double longer = stop_duration_until(s_ + rate * duration);
    if (longer <= duration) break;
    duration = longer;
  }
  return duration;
}

double Motion::remaining() const noexcept {
  return (child_ != nullptr ? child_->splice_t + child_->duration() : plan_->duration()) - s_;
}

void Motion::change_rate(double target) noexcept {
  if (mode_ != Mode::kPath) return;
  const double duration = ramp_duration(target);
  if (target < ramp_.rate() && ramp_.distance_of_change(target, duration) >= remaining()) return;
  ramp_.change(target, duration);
}

void Motion::begin_path_stop() noexcept {
  if (mode_ != Mode::kPath) return;
  child_ = nullptr;
  const double duration = ramp_duration(0.0);
  if (ramp_.distance_of_change(0.0, duration) >= remaining()) return;
  ramp_.change(0.0, duration);
}

void Motion::begin_joint_stop() noexcept {
  joint_stop_.begin(reference_, limits_, dof_);
  stop_t_ = 0.0;
  drop_plan();
  mode_ = Mode::kJointStop;
}

bool Motion::at_rest() const noexcept {
  switch (mode_) {
    case Mode::kRest: return true;
    case Mode::kPath: return ended() || halted();
    case Mode::kJointStop: return stop_t_ >= joint_stop_.duration();
  }
  return false;
}

const Reference& Motion::advance() noexcept {
  switch (mode_) {
    case Mode::kRest: next_ = reference_; break;
    case Mode::kPath: advance_path(); break;
    case Mode::kJointStop:
      stop_t_ += dt_;
      next_ = joint_stop_.at(stop_t_);
      break;
  }
  return next_;
}

void Motion::advance_path() noexcept {
  const RateRamp::Step step = ramp_.advance(dt_);
  s_ += step.distance;
  const double r = step.rate, r_dot = step.rate_dot;
  const auto at_rate = [&](const PathPoint& p) noexcept {
    Reference out;
    for (int joint = 0; joint < dof_; ++joint) {
      out.q[joint] = p.q[joint];
      out.dq[joint] = p.dq[joint] * r;
      out.ddq[joint] = p.ddq[joint] * r * r + p.dq[joint] * r_dot;
    }
    return out;
  };
  // A child may begin where its parent ends: rounding must not end the plan just before.
  if (child_ != nullptr && s_ > child_->splice_t - kEnd_s) take_over(r);
  if (s_ > plan_->duration() - kEnd_s) s_ = plan_->duration();
  next_ = at_rate(cursor_.at(s_));
  add_fade();
}

void Motion::begin_fade(const PathPoint& left_over) noexcept {
  fade_t_ = kFadeDuration_s;
  for (int joint = 0; joint < dof_; ++joint) {
    const double p = left_over.q[joint], v = left_over.dq[joint], a = left_over.ddq[joint];
    fade_[joint] = Quintic::hermite(kFadeDuration_s, {p, v, a, 0.0}, {});
    if (p != 0.0 || v != 0.0 || a != 0.0) fade_t_ = 0.0;
  }
}

// Both plans describe the same point here up to the SPLICE tolerance. That remainder fades, together with what is
// left of an earlier one.
void Motion::take_over(double rate) noexcept {
  PathPoint left_over;
  const PathPoint parent = cursor_.at(child_->splice_t);
  for (int joint = 0; joint < dof_; ++joint) {
    const Motion1 fading = faded() ? Motion1{} : fade_[joint].at(fade_t_);
    left_over.q[joint] = fading.p + parent.q[joint] - child_->q[0][joint];
    left_over.dq[joint] = fading.v + (parent.dq[joint] - child_->dq[0][joint]) * rate;
    left_over.ddq[joint] = fading.a + (parent.ddq[joint] - child_->ddq[0][joint]) * rate * rate;
  }
  s_ = std::max(0.0, s_ - child_->splice_t);
  plan_ = child_;
  child_ = nullptr;
  cursor_.open(*plan_);
  begin_fade(left_over);
}

void Motion::add_fade() noexcept {
  if (faded()) return;
  fade_t_ = std::min(fade_t_ + dt_, kFadeDuration_s);
  for (int joint = 0; joint < dof_; ++joint) {
    const Motion1 m = fade_[joint].at(fade_t_);
    next_.q[joint] += m.p;
    next_.dq[joint] += m.v;
    next_.ddq[joint] += m.a;
  }
}

}  // namespace s2r
