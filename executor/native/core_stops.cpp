// Watchdogs, stops and state transitions of the core.
#include <algorithm>
#include <cmath>

#include "core.hpp"

namespace s2r {
namespace {

constexpr double kResetTimeout_s = 0.5;
constexpr double kQuickStopTime_s = 1.0;  // drives brake by themselves; then power off
constexpr double kWarningInterval_s = 1.0;

}  // namespace

void Core::watch() noexcept {
  watch_estop();
  const bool silent = front_end_silence_s_ > config_.front_end_timeout_s;
  const Trip silence{Cause::kFrontEndLost, -1, front_end_silence_s_, config_.front_end_timeout_s};
  if (silent && !front_end_lost_) {
    emit(EventKind::kWatchdog, silence);
    stop(silence);
  } else if (silent && (state_ == State::kArming || state_ == State::kRun || state_ == State::kPaused)) {
    stop(silence);
  }
  front_end_lost_ = silent;
  const bool off = !powered() && sent_.request == DriveRequest::kDisable;
  if (foreign_master_ && front_end_lost_ && off) {
    quit_done_ = true;  // nobody commands this core any more and another one has taken over
    return;
  }

  if (powered()) {
    watch_powered();
  } else if (state_ == State::kArming) {
    watch_arming();
  } else if (state_ == State::kDisarmed) {
    watch_disarmed();
  }
  if (!powered()) (void)plausibility_.check(drives_, age_, sent_q_ref_, false);
  watch_warnings();
  watch_brakes();
  watch_reset();
  foreign_master_ = false;
}

Observed Core::observed() const noexcept {
  return {drives_,         age_,     torque_age_,     tx_failed_in_a_row_,
          foreign_master_, bus_off_, foreign_.load(), foreign_.limit()};
}

// Every finding is tried in this order; the first that leads to a harder stop than the one under way takes it.
void Core::watch_powered() noexcept {
  warn_late_answers();
  for (const auto& check : {check_bus, check_feedback, check_drives}) {
    const Finding finding = check(config_, observed());
    const bool on_purpose = finding.trip.cause == Cause::kDriveNotEnabled && (closing_brakes_ || reenabling_);
    if (!on_purpose) act_on(finding);
  }
  if (!closing_brakes_ && !reenabling_) stop(check_brakes(config_, drives_));
  stop(find_following_error());
  stop(plausibility_.check(drives_, age_, sent_q_ref_, true));
  if (sent_tau_known_)
    stop(collision_.check(drives_, age_, sent_tau_));
  else
    collision_.forget();
  stop(check_temperature(config_, drives_));
}

Trip Core::find_following_error() const noexcept {
  for (int joint = 0; joint < config_.dof; ++joint) {
    if (age_[joint] != 0) continue;
    const double error = drives_[joint].q - sent_q_ref_[joint], limit = window_.allowed(joint, path_tolerance());
    if (!(std::abs(error) <= limit)) return {Cause::kFollowing, joint, error, limit};
  }
  return {};
}

// The hardware has removed the power already: take note, let go, latch. A broken contact found later is the cause then.
void Core::watch_estop() noexcept {
  const Trip trip = estop_.observe(drives_, config_.dof);
  if (!trip) return;
  if (state_ != State::kEstop) {
    cause_ = trip;
    ++epoch_;
    quick_stop_ = resetting_ = false;
    emit(EventKind::kStopBegun, trip);
    apply(Trigger::kEstopOpen);
  } else if (cause_.cause != trip.cause && trip.cause == Cause::kEstopDiscrepancy) {
    cause_ = trip;
    emit(EventKind::kLatch, trip);
  }
}

// A drive that warns slows the plan down; it goes back to full speed when the warning is gone.
void Core::watch_warnings() noexcept {
  const Trip warning = check_warnings(config_, drives_, slowed_);
  if (static_cast<bool>(warning) != slowed_) {
    slowed_ = !slowed_;
    emit(EventKind::kWatchdog, warning);
  }
  const bool other_speed = motion_.target_rate() > 0.0 && motion_.target_rate() != allowed_speed();
  if (state_ == State::kRun && other_speed) motion_.change_rate(allowed_speed());
}

void Core::close_brakes() noexcept {
  closing_brakes_ = true;
  brakes_since_tick_ = tick_;
}

// Brakes before power. Nobody waits in vain: not for a drive that is off, in fault or in a quick stop of its own, which
// only "disable" ends, and for none when setpoints do not leave any more, so that the drives stop by themselves.
void Core::watch_brakes() noexcept {
  if (reenabling_) watch_reenabling();
  if (!closing_brakes_) return;
  const int enabled = first_enabled(), unbraked = first_unbraked();
  const bool in_vain = tx_failed_in_a_row_ > static_cast<std::uint32_t>(config_.drive_extrapolation_ticks);
  const bool too_long = seconds_since(brakes_since_tick_) > config_.brake_timeout_s;
  const bool closed = enabled < 0 && unbraked < 0;
  const bool disobeyed = too_long && state_ != State::kHold && unbraked < 0;  // stays enabled behind its closed brake
  if (in_vain || closed || disobeyed)
    brakes_closed();
  else if (too_long)
    brake_stays_open(unbraked >= 0 ? unbraked : enabled);
}

void Core::brakes_closed() noexcept {
  if (state_ == State::kHold) {
    cause_ = {Cause::kDisarmRequested};
    apply(Trigger::kDisarm);
  } else {
    apply(Trigger::kAtRest);
  }
}

// Without its brake the joint would fall. HOLD enables all drives again. STOP1 enables none: it goes on asking for
// "disable operation", under which a drive keeps its torque until its brake has closed, and ends when it has. A joint
// whose position is not to be believed is not held.
void Core::brake_stays_open(int joint) noexcept {
  const Trip brake{Cause::kBrake, joint, 1.0, 0.0};
  if (state_ == State::kHold) {
    closing_brakes_ = disarm_pending_ = false;
    reenabling_ = true;
    brakes_since_tick_ = tick_;
    cause_ = brake;
    emit(EventKind::kWatchdog, brake);
    reject(0, {Refusal::kState, joint, double(static_cast<int>(state_)), 1.0});
    return;
  }
  if (cause_.cause == Cause::kBrake) return;  // told
  const bool believed = cause_.cause != Cause::kPlausibility || cause_.joint != joint;
  emit(EventKind::kWatchdog, brake);
  if (believed)
    cause_ = brake;
  else
    apply(Trigger::kAtRest);
}

void Core::watch_reenabling() noexcept {
  if (first_not_enabled() < 0 && !check_brakes(config_, drives_))
    reenabling_ = false;
  else if (seconds_since(brakes_since_tick_) > config_.arming_timeout_s)
    stop({Cause::kDriveNotEnabled, first_not_enabled(), 0.0, 0.0});
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
  if (const Finding bus = check_bus(config_, observed()); bus.trip) {
    act_on(bus);
    return;
  }
  const Silence silence = find_silence(config_, age_, torque_age_, config_.feedback_fault_ticks);
  const int faulty = first_in_fault(), waiting = first_not_enabled();
  const Trip brake = check_brakes(config_, drives_);
  if (silence.joint >= 0) {
    stop({Cause::kFeedbackLost, silence.joint, silence.age, silence.limit});
  } else if (faulty >= 0) {
    stop({Cause::kDriveFault, faulty, double(drives_[faulty].error), 0.0});
  } else if (waiting < 0 && !brake) {
    apply(Trigger::kDrivesEnabled);
  } else if (waiting < 0) {
    if (dt_ * static_cast<double>(++enabled_ticks_) > config_.brake_timeout_s) stop(brake);
  } else if (seconds_since(state_since_tick_) > config_.arming_timeout_s) {
    stop({Cause::kArmingTimeout, waiting, double(static_cast<int>(drives_[waiting].state)),
          double(static_cast<int>(DriveState::kOperationEnabled))});
  }
}

// A bus-off is over when every drive has answered to what left after it.
void Core::watch_disarmed() noexcept {
  bool answers = true;
  for (int joint = 0; joint < config_.dof; ++joint)
    answers &= drives_[joint].seen && drives_[joint].answered_tick >= bus_off_tick_;
  if (answers) bus_off_ = false;
}

// A latch clears when every drive answers and none is in fault, and not by itself: only after a fresh RESET. One that
// comes while the drives still brake waits for them.
void Core::watch_reset() noexcept {
  if (quick_stop_ && seconds_since(state_since_tick_) > kQuickStopTime_s) quick_stop_ = false;
  if (quick_stop_) reset_since_tick_ = tick_;
  if (!resetting_ || tick_ == reset_since_tick_) return;
  const Silence silence = find_silence(config_, age_, torque_age_, config_.feedback_stop_ticks);
  const bool answers = silence.joint < 0;
  const int faulty = first_in_fault();
  if (answers && faulty < 0 && estop_.closed()) {
    resetting_ = bus_off_ = false;
    estop_.reset();
    apply(Trigger::kReset);
  } else if (seconds_since(reset_since_tick_) > kResetTimeout_s) {
    resetting_ = false;
    if (!answers)
      reject(0, {Refusal::kState, silence.joint, silence.age, silence.limit});
    else
      reject(0, {Refusal::kState, faulty, faulty < 0 ? 0.0 : double(drives_[faulty].error), 0.0});
  }
}

void Core::choose_request() noexcept {
  request_ = DriveRequest::kDisable;
  if (powered()) {
    request_ = closing_brakes_ ? DriveRequest::kDisableOperation : DriveRequest::kEnable;
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

void Core::act_on(const Finding& finding) noexcept {
  if (finding.drives_off)
    drives_off(finding.trip);
  else
    stop(finding.trip);
}

void Core::drives_off(const Trip& trip) noexcept { stop_with(trip, Trigger::kStopCat0); }

void Core::stop_with(const Trip& trip, Trigger trigger) noexcept {
  const bool while_holding = state_ == State::kHold && trigger == Trigger::kStopCat2;
  if (next_state(state_, trigger) == state_ && !while_holding) return;  // nothing moves, or a harder stop is under way
  if (state_ == State::kStop1) {
    emit(EventKind::kWatchdog, trip);  // the same stop by harder means: it keeps the cause that began it
  } else {
    cause_ = trip;
    ++epoch_;  // whatever was on its way is void
    emit(EventKind::kStopBegun, trip);
  }
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
  closing_brakes_ = reenabling_ = false;
  enabled_ticks_ = 0;
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
  if (state_ == State::kHold && disarm_pending_) {
    disarm_pending_ = false;
    (void)disarm();
  }
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

int Core::first_enabled() const noexcept {
  for (int joint = 0; joint < config_.dof; ++joint)
    if (drives_[joint].state == DriveState::kOperationEnabled) return joint;
  return -1;
}

int Core::first_unbraked() const noexcept {
  for (int joint = 0; joint < config_.dof; ++joint) {
    const DriveState drive = drives_[joint].state;
    const bool has_torque = drive == DriveState::kSwitchedOn || drive == DriveState::kOperationEnabled;
    if (has_torque && drives_[joint].brake_released) return joint;
  }
  return -1;
}

int Core::oldest_answer() const noexcept {
  int oldest = 0;
  for (int joint = 1; joint < config_.dof; ++joint)
    if (age_[joint] > age_[oldest]) oldest = joint;
  return oldest;
}

double Core::path_tolerance() const noexcept {
  return path_tolerance_ > 0.0 ? path_tolerance_ : config_.path_tolerance_rad;
}

double Core::goal_tolerance() const noexcept {
  const double asked = motion_.has_plan() ? motion_.plan()->goal_tolerance : 0.0;
  return asked > 0.0 ? asked : config_.goal_tolerance_rad;
}

}  // namespace s2r
