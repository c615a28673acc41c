// The commanded reference: at rest, along a plan (path time), or in a joint-space stop. Anchored on what was
// commanded, never on what was measured; adopt() at arming is the only exception.
#pragma once

#include "joint_stop.hpp"
#include "spline.hpp"
#include "time_scaling.hpp"
#include "types.hpp"

namespace s2r {

class Motion {
 public:
  void configure(const Limits& limits, int dof, double dt) noexcept;

  // At rest at q; forgets any plan.
  void adopt(const Joints& q) noexcept;
  // From rest; path time begins with the next advance(). The plan must stay alive until it is dropped.
  void start(const Plan& plan, double rate) noexcept;
  // The child takes over where the running plan reaches its splice_t; it replaces one that still waits for that.
  void splice(const Plan& child) noexcept;
  // Pause (0), resume, speed. Without effect where the plan ends before the new rate would be reached.
  void change_rate(double target) noexcept;
  // Time scaling to rest. If the plan ends sooner it simply ends.
  void begin_path_stop() noexcept;
  void begin_joint_stop() noexcept;
  // Forget the plan where the reference stands; only at rest.
  void drop_plan() noexcept;

  // The reference one tick later. Not yet valid for the next call until committed.
  const Reference& advance() noexcept;
  void commit() noexcept { reference_ = next_; }

  const Reference& reference() const noexcept { return reference_; }
  const Reference& next() const noexcept { return next_; }
  // The reference of the plan at path time s, as planned (rate 1).
  PathPoint planned(double s) noexcept { return cursor_.at(s); }

  // Torque that admission expects for the reference on the path [N m]; only while knows_torque().
  bool knows_torque() const noexcept { return mode_ == Mode::kPath && plan_->has_torque; }
  Joints expected_torque() const noexcept { return cursor_.torque(s_, ramp_.rate()); }

  bool has_plan() const noexcept { return plan_ != nullptr; }
  const Plan* plan() const noexcept { return plan_; }
  const Plan* child() const noexcept { return child_; }
  double plan_t() const noexcept { return s_; }
  double rate() const noexcept { return ramp_.rate(); }
  double target_rate() const noexcept { return ramp_.target(); }
  bool ended() const noexcept { return mode_ == Mode::kPath && s_ >= plan_->duration() && faded(); }
  bool halted() const noexcept { return mode_ == Mode::kPath && ramp_.steady() && ramp_.rate() == 0.0 && faded(); }
  bool at_rest() const noexcept;
  // Seconds since the joint-space stop began.
  double stop_t() const noexcept { return stop_t_; }

 private:
  enum class Mode : unsigned char { kRest, kPath, kJointStop };
  void advance_path() noexcept;
  void take_over(double rate) noexcept;
  void begin_fade(const PathPoint& left_over) noexcept;
  void add_fade() noexcept;
  bool faded() const noexcept { return fade_t_ >= kFadeDuration_s; }
  double remaining() const noexcept;  // path time until rest [s]
  double stop_duration_until(double s_to) const noexcept;
  double ramp_duration(double target) const noexcept;  // of a change of rate that begins now [s]

  // A plan may start a hair off the reference (the START and SPLICE tolerances). The difference fades out over this
  // time instead of being a step: 1e-4 rad costs at most 60 * 1e-4 / 0.2^3 = 0.75 rad/s3 of jerk.
  static constexpr double kFadeDuration_s = 0.2;

  Limits limits_{};
  int dof_ = 0;
  double dt_ = 0.001;

  Mode mode_ = Mode::kRest;
  Reference reference_{}, next_{};
  const Plan* plan_ = nullptr;
  const Plan* child_ = nullptr;
  PlanCursor cursor_{};
  RateRamp ramp_{};
  double s_ = 0.0;
  PerJoint<Quintic> fade_{};
  double fade_t_ = kFadeDuration_s;
  JointStop joint_stop_{};
  double stop_t_ = 0.0;
};

}  // namespace s2r
