#include "protective.hpp"

#include <algorithm>
#include <cmath>

namespace s2r {

// --- emergency stop -------------------------------------------------------------------------------------------------

void EstopChain::configure(double discrepancy_s, double dt) noexcept {
  *this = EstopChain(static_cast<std::uint32_t>(std::max(1.0, std::round(discrepancy_s / dt))));
}

Trip EstopChain::observe(const PerJoint<JointFeedback>& drives, int dof) noexcept {
  open_ = 0;
  for (int joint = 0; joint < dof; ++joint)
    if (drives[joint].seen) open_ |= drives[joint].estop_open;
  seen_open_ |= open_;
  const bool disagree = open_ != 0 && open_ != kBoth;
  disagreeing_ticks_ = disagree ? disagreeing_ticks_ + 1 : 0;
  if (disagreeing_ticks_ > limit_ticks_) broken_ = true;
  if (open_ == 0) {
    if (seen_open_ != 0 && seen_open_ != kBoth) broken_ = true;  // the other channel slept through the demand
    seen_open_ = 0;
  }
  if (broken_) return {Cause::kEstopDiscrepancy, -1, double(open_), 0.0};
  if (open_ != 0) return {Cause::kEstop, -1, double(open_), 0.0};
  return {};
}

// --- plausibility ---------------------------------------------------------------------------------------------------

void Plausibility::configure(const Limits& limits, int dof, double dt, double frozen_rad) noexcept {
  *this = Plausibility{};
  limits_ = limits;
  dof_ = dof;
  dt_ = dt;
  frozen_rad_ = frozen_rad;
}

Trip Plausibility::check(const PerJoint<JointFeedback>& drives, const Ages& age, const Joints& q_ref,
                         bool judge) noexcept {
  Trip first;
  for (int joint = 0; joint < dof_; ++joint) {
    if (age[joint] != 0) continue;
    const Trip trip = check_joint(joint, drives[joint], q_ref[joint], judge);
    if (trip && !first) first = trip;
  }
  return first;
}

Trip Plausibility::check_joint(int joint, const JointFeedback& drive, double q_ref, bool judge) noexcept {
  constexpr double kOverSpeed = 1.5, kSlack_rad = 0.002;
  constexpr int kStillAnswers = 4;
  Track& track = tracks_[joint];
  if (drive.answered_tick == track.tick && track.known) return {};  // already judged
  const double step = drive.q - track.q;
  const double ticks = static_cast<double>(drive.answered_tick - track.tick);
  const double longest = kOverSpeed * limits_.dq_max[joint] * dt_ * ticks + kSlack_rad;
  const bool known = track.known && judge;
  const bool still = known && step == 0.0;
  track.ref_travel = still ? track.ref_travel + std::abs(q_ref - track.q_ref) : 0.0;
  track.still_answers = still ? track.still_answers + 1 : 0;
  track.known = true;
  track.q = drive.q;
  track.q_ref = q_ref;
  track.tick = drive.answered_tick;
  if (known && !(std::abs(step) <= longest)) return {Cause::kPlausibility, joint, step, longest};
  if (track.still_answers >= kStillAnswers && !(track.ref_travel <= frozen_rad_))
    return {Cause::kPlausibility, joint, track.ref_travel, frozen_rad_};
  return {};
}

// --- collision ------------------------------------------------------------------------------------------------------

// As many samples as the first and the last of them need to lie so many ticks apart, both counted.
void CollisionWatch::configure(const Limits& limits, int dof, double share, int ticks, int every) noexcept {
  *this = CollisionWatch{};
  limits_ = limits;
  dof_ = dof;
  share_ = share;
  samples_ = 1 + (ticks - 1 + every - 1) / every;
}

Trip CollisionWatch::check(const PerJoint<JointFeedback>& drives, const Ages& age,
                           const Joints& tau_expected) noexcept {
  for (int joint = 0; joint < dof_; ++joint) {
    if (age[joint] != 0 || drives[joint].torque_samples == judged_[joint]) continue;
    judged_[joint] = drives[joint].torque_samples;
    const double residual = drives[joint].tau - tau_expected[joint], limit = share_ * limits_.tau_max[joint];
    outside_[joint] = std::abs(residual) <= limit ? 0 : outside_[joint] + 1;  // NaN counts as outside
    if (outside_[joint] >= samples_) return {Cause::kCollision, joint, residual, limit};
  }
  return {};
}

// --- following window -----------------------------------------------------------------------------------------------

void FollowingWindow::configure(const Limits& limits, int dof, double dt, double rest_share) noexcept {
  *this = FollowingWindow{};
  limits_ = limits;
  dof_ = dof;
  rest_share_ = rest_share;
  fade_ = std::exp(-dt / 0.1);
}

void FollowingWindow::advance(const Joints& dq_ref) noexcept {
  for (int joint = 0; joint < dof_; ++joint) speed_[joint] = std::max(std::abs(dq_ref[joint]), fade_ * speed_[joint]);
}

double FollowingWindow::allowed(int joint, double tolerance) const noexcept {
  constexpr double kFullWindowFrom = 0.25;  // of the largest speed
  const double share = std::min(1.0, speed_[joint] / (kFullWindowFrom * limits_.dq_max[joint]));
  return tolerance * (rest_share_ + (1.0 - rest_share_) * share);
}

// --- bus load -------------------------------------------------------------------------------------------------------

// What our own traffic leaves of the bus is the most that others may take; short bursts below 0.3 hurt nobody.
void ForeignLoad::configure(double own_load, double dt) noexcept {
  *this = ForeignLoad{};
  dt_ = dt;
  limit_ = std::max(0.3, 1.0 - own_load);
}

void ForeignLoad::close_tick(std::uint64_t ticks) noexcept {
  constexpr double kWeight = 1.0 / 3.0;
  const double now = pending_s_ / (dt_ * static_cast<double>(std::max<std::uint64_t>(ticks, 1)));
  load_ += kWeight * (std::min(now, 1.0) - load_);
  pending_s_ = 0.0;
}

// --- drives ---------------------------------------------------------------------------------------------------------

Trip check_temperature(const Config& config, const PerJoint<JointFeedback>& drives) noexcept {
  for (int joint = 0; joint < config.dof; ++joint)
    if (drives[joint].temperature_C >= config.temperature_stop_C)
      return {Cause::kOverTemperature, joint, double(drives[joint].temperature_C), double(config.temperature_stop_C)};
  return {};
}

Trip check_warnings(const Config& config, const PerJoint<JointFeedback>& drives, bool slowed) noexcept {
  constexpr int kHysteresis_C = 5;
  const int warm = config.temperature_warn_C - (slowed ? kHysteresis_C : 0);
  for (int joint = 0; joint < config.dof; ++joint) {
    const JointFeedback& drive = drives[joint];
    if (drive.temperature_C >= warm) return {Cause::kOverTemperature, joint, double(drive.temperature_C), double(warm)};
    if (drive.error != 0 && drive.state == DriveState::kOperationEnabled)
      return {Cause::kDriveFault, joint, double(drive.error), 0.0};
  }
  return {};
}

Trip check_brakes(const Config& config, const PerJoint<JointFeedback>& drives) noexcept {
  if (!config.brake_feedback) return {};
  for (int joint = 0; joint < config.dof; ++joint)
    if (drives[joint].state == DriveState::kOperationEnabled && !drives[joint].brake_released)
      return {Cause::kBrake, joint, 0.0, 1.0};
  return {};
}

}  // namespace s2r
