// Watchdogs, stops and state transitions of the core.
#include <algorithm>

#include "core.hpp"

namespace s2r {
namespace {

constexpr double kResetTimeout_s = 0.5;
constexpr double kQuickStopTime_s = 1.0;  // drives brake by themselves; then power off
constexpr double kWarningInterval_s = 1.0;

}  // namespace

void Core::watch() noexcept {
  const bool silent = front_end_silence_s_ > config_.front_end_timeout_s;
  const Trip silence{Cause::kFrontEndLost, -1, front_end_silence_s_, config_.front_end_timeout_s};
  if (silent && !front_end_lost_) {
    emit(EventKind::kWatchdog, silence);
    stop(silence);
  } else if (silent && (state_ == State::kArming || state_ == State::kRun || state_ == State::kPaused)) {
    stop(silence);
  }
  front_end_lost_ = silent;
  if (foreign_master_ && front_end_lost_ && (state_ == State::kHold || !powered())) {
    quit_done_ = true;  // nobody commands this core any more and another one has taken over
    return;
  }

  if (powered()) {
    const Observed seen{
        drives_,         age_,    sent_q_ref_, path_tolerance(), front_end_silence_s_, tx_failed_in_a_row_,
        foreign_master_, bus_off_};
    warn_late_answers();
    for (const auto& check : {check_feedback, check_drives, check_following}) {
      const Finding finding = check(config_, seen);
      if (!finding.trip) continue;
      if (finding.drives_off)
        drives_off(finding.trip);
      else
        stop(finding.trip);
    }
  } else if (state_ == State::kArming) {
    watch_arming();
  }
  watch_reset();
  foreign_master_ = false;
}

void Core::warn_late_answers() noexcept {
  for (int joint = 0; joint < config_.dof; ++joint) {
    if (age_[joint] < static_cast<std::uint32_t>(config_.feedback_warn_ticks)) continue;
    const bool recently = warned_tick_[joint] != 0 && seconds_since(warned_tick_[joint]) < kWarningInterval_s;
    if (recently) continue;
    warned_tick_[joint] = tick_;
    emit(EventKind::kWatchdog, {Cause::kFeedbackLost, joint, double(age_[joint]), double(config_.feedback_warn_ticks)});
  }
}

void Core::watch_arming() noexcept {
  const int oldest = oldest_answer(), faulty = first_in_fault(), waiting = first_not_enabled();
  if (age_[oldest] >= static_cast<std::uint32_t>(config_.feedback_fault_ticks))
    stop({Cause::kFeedbackLost, oldest, double(age_[oldest]), double(config_.feedback_fault_ticks)});
  else if (faulty >= 0)
    stop({Cause::kDriveFault, faulty, double(drives_[faulty].error), 0.0});
  else if (waiting < 0)
    apply(Trigger::kDrivesEnabled);
  else if (seconds_since(state_since_tick_) > config_.arming_timeout_s)
    stop({Cause::kArmingTimeout, waiting, double(static_cast<int>(drives_[waiting].state)),
          double(static_cast<int>(DriveState::kOperationEnabled))});
}

// A latch clears when every drive answers and none is in fault, and not by itself: only after a fresh RESET.
void Core::watch_reset() noexcept {
  if (quick_stop_ && seconds_since(state_since_tick_) > kQuickStopTime_s) quick_stop_ = false;
  if (!resetting_ || tick_ == reset_since_tick_) return;
  const int oldest = oldest_answer(), faulty = first_in_fault();
  const bool answers = age_[oldest] < static_cast<std::uint32_t>(config_.feedback_stop_ticks);
  if (answers && faulty < 0) {
    resetting_ = bus_off_ = false;
    apply(Trigger::kReset);
  } else if (seconds_since(reset_since_tick_) > kResetTimeout_s) {
    resetting_ = false;
    reject(0, {Refusal::kState, answers ? faulty : oldest, double(static_cast<int>(state_)), 0.0});
  }
}

void Core::choose_request() noexcept {
  request_ = DriveRequest::kDisable;
  if (powered()) {
    request_ = DriveRequest::kEnable;
  } else if (state_ == State::kArming) {
    bool switched_on = true;
    for (int joint = 0; joint < config_.dof; ++joint) {
      const DriveState drive = drives_[joint].state;
      switched_on &= drive == DriveState::kSwitchedOn || drive == DriveState::kOperationEnabled;
    }
    request_ = switched_on ? DriveRequest::kEnable : DriveRequest::kSwitchOn;
  } else if (quick_stop_) {
    request_ = DriveRequest::kQuickStop;
  } else if (resetting_ && first_in_fault() >= 0) {
    request_ = DriveRequest::kFaultReset;
  }
}

void Core::stop(const Trip& trip) noexcept {
  switch (category_of(trip.cause)) {
    case StopCategory::kCat2: stop_with(trip, Trigger::kStopCat2); return;
    case StopCategory::kCat1: stop_with(trip, Trigger::kStopCat1); return;
    case StopCategory::kCat0: stop_with(trip, Trigger::kStopCat0); return;
    case StopCategory::kNone: return;
  }
}

void Core::drives_off(const Trip& trip) noexcept { stop_with(trip, Trigger::kStopCat0); }

void Core::stop_with(const Trip& trip, Trigger trigger) noexcept {
  const bool while_holding = state_ == State::kHold && trigger == Trigger::kStopCat2;
  if (next_state(state_, trigger) == state_ && !while_holding) return;  // nothing moves, or a harder stop is under way
  cause_ = trip;
  ++epoch_;  // whatever was on its way is void
  emit(EventKind::kStopBegun, trip);
  if (while_holding) emit(EventKind::kStopDone, trip);
  if (trigger == Trigger::kStopCat0) quick_stop_ = powered() && !motion_.at_rest();
  apply(trigger);
}

void Core::apply(Trigger trigger) noexcept {
  const State from = state_;
  state_ = next_state(from, trigger);
  if (state_ != from) enter(from);
}

void Core::enter(State from) noexcept {
  state_since_tick_ = tick_;
  emit(EventKind::kState, cause_);
  switch (state_) {
    case State::kHold: {
      if (from == State::kArming) {
        motion_.adopt(setpoint_q_);
        EncodedSetpoint at_rest;
        for (int joint = 0; joint < config_.dof; ++joint) at_rest[joint] = encode_joint(setpoint_q_[joint], 0.0);
        gate_.reset(at_rest);
      }
      motion_.drop_plan();
      break;
    }
    case State::kStopping: motion_.begin_path_stop(); break;
    case State::kStop1: motion_.begin_joint_stop(); break;
    case State::kFault:
    case State::kEstop:
      emit(EventKind::kLatch, cause_);
      disarm_pending_ = false;
      motion_.drop_plan();
      break;
    case State::kDisarmed:
      disarm_pending_ = resetting_ = quick_stop_ = false;
      motion_.drop_plan();
      break;
    default: break;
  }
  release_plans();
  if (state_ == State::kHold && disarm_pending_) apply(Trigger::kDisarm);
}

// Slots of plans that were taken in and are no longer played go back to the front end.
void Core::release_plans() noexcept {
  for (PlanSlot& slot : shared_.plans) {
    const bool taken = slot.filled.load(std::memory_order_acquire) != 0 && slot.order < next_plan_order_;
    const bool in_use = &slot.plan == motion_.plan() || &slot.plan == motion_.child();
    if (taken && !in_use) slot.filled.store(0, std::memory_order_release);
  }
}

void Core::emit(EventKind kind, const Trip& trip) noexcept {
  Event event{.tick = tick_, .stamp_ns = now_ns_, .plan_id = plan_id_, .value = trip.value, .limit = trip.limit};
  event.kind = static_cast<std::uint16_t>(kind);
  event.cause = static_cast<std::uint16_t>(trip.cause);
  event.joint = static_cast<std::int16_t>(trip.joint);
  event.state = static_cast<std::uint8_t>(state_);
  events_.push(event);
}

int Core::first_in_fault() const noexcept {
  for (int joint = 0; joint < config_.dof; ++joint)
    if (drives_[joint].state == DriveState::kFault || drives_[joint].state == DriveState::kFaultReaction) return joint;
  return -1;
}

int Core::first_not_enabled() const noexcept {
  for (int joint = 0; joint < config_.dof; ++joint)
    if (drives_[joint].state != DriveState::kOperationEnabled) return joint;
  return -1;
}

int Core::oldest_answer() const noexcept {
  int oldest = 0;
  for (int joint = 1; joint < config_.dof; ++joint)
    if (age_[joint] > age_[oldest]) oldest = joint;
  return oldest;
}

double Core::path_tolerance() const noexcept {
  const double asked = motion_.has_plan() ? motion_.plan()->path_tolerance : 0.0;
  return asked > 0.0 ? asked : config_.path_tolerance_rad;
}

double Core::goal_tolerance() const noexcept {
  const double asked = motion_.has_plan() ? motion_.plan()->goal_tolerance : 0.0;
  return asked > 0.0 ? asked : config_.goal_tolerance_rad;
}

}  // namespace s2r
