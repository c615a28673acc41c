// The core's side of the rings: commands and plans from the front end.
#include <cmath>

#include "core.hpp"
#include "plan_check.hpp"

namespace s2r {
namespace {

constexpr std::uint64_t kQuitTicks = 3;  // setpoints with "disable" before the process ends

// What leads towards a stop is taken whatever the epoch.
bool needs_epoch(CommandKind kind) noexcept {
  return kind != CommandKind::kStop && kind != CommandKind::kDisarm && kind != CommandKind::kQuit;
}

}  // namespace

void Core::take_commands() noexcept {
  Command command;
  while (commands_.pop(command)) take_command(command);
}

void Core::take_command(const Command& command) noexcept {
  const auto kind = static_cast<double>(static_cast<std::uint32_t>(command.kind));
  if (needs_epoch(command.kind) && command.epoch != epoch_) {
    reject(0, {Refusal::kStale, -1, double(command.epoch), double(epoch_)});
    return;
  }
  Refused refused;
  switch (command.kind) {
    case CommandKind::kArm: refused = arm(); break;
    case CommandKind::kDisarm: refused = disarm(); break;
    case CommandKind::kStop: take_stop(command.value); break;
    case CommandKind::kPause:
      if (state_ == State::kRun)
        motion_.change_rate(0.0);
      else if (state_ != State::kPaused)
        refused = {Refusal::kState, -1, kind, 0.0};
      break;
    case CommandKind::kResume:
      if (state_ == State::kPaused) {
        cause_ = {};
        apply(Trigger::kResume);
      }
      if (state_ == State::kRun)
        motion_.change_rate(allowed_speed());
      else
        refused = {Refusal::kState, -1, kind, 0.0};
      break;
    case CommandKind::kSetSpeed: refused = set_speed(command.value); break;
    case CommandKind::kReset: refused = reset(); break;
    case CommandKind::kQuit: request_quit(); break;
    case CommandKind::kUnspecified:
    default: refused = {Refusal::kMalformed, -1, kind, 0.0};
  }
  if (refused) reject(0, refused);
}

Refused Core::arm() noexcept {
  if (state_ != State::kDisarmed || quit_ || !estop_.closed())
    return {Refusal::kState, -1, double(static_cast<int>(state_)), 1.0};
  if (const Cause cause = unfit_bus(); cause != Cause::kNone)
    return {Refusal::kState, -1, double(static_cast<std::uint16_t>(cause)), 0.0};
  const Silence silence = find_silence(config_, age_, torque_age_, config_.feedback_fault_ticks);
  if (silence.joint >= 0) return {Refusal::kState, silence.joint, silence.age, silence.limit};
  for (int joint = 0; joint < config_.dof; ++joint) {
    const double q = drives_[joint].q;
    if (!(q >= config_.limits.q_min[joint])) return {Refusal::kPosition, joint, q, config_.limits.q_min[joint]};
    if (!(q <= config_.limits.q_max[joint])) return {Refusal::kPosition, joint, q, config_.limits.q_max[joint]};
  }
  cause_ = {};
  speed_ = 1.0;
  path_tolerance_ = 0.0;
  ++epoch_;
  apply(Trigger::kArm);
  return {};
}

// What on the bus speaks against switching drives on. The front end tells it by this number.
Cause Core::unfit_bus() const noexcept {
  if (tick_ < foreign_until_tick_) return Cause::kForeignMaster;
  if (bus_off_) return Cause::kBusOff;
  return check_bus(config_, observed()).trip.cause;
}

Refused Core::disarm() noexcept {
  switch (state_) {
    case State::kHold:
      if (closing_brakes_) return {};
      if (reenabling_) return {Refusal::kState, first_not_enabled(), double(static_cast<int>(state_)), 3.0};
      if (config_.brake_feedback) {  // power stays on until every brake has closed: watch_brakes()
        close_brakes();
        ++epoch_;
        return {};
      }
      [[fallthrough]];
    case State::kArming:
      cause_ = {Cause::kDisarmRequested};
      ++epoch_;
      apply(Trigger::kDisarm);
      return {};
    case State::kRun:
    case State::kPaused:
    case State::kStopping:
      disarm_pending_ = true;
      stop({Cause::kDisarmRequested});
      return {};
    case State::kDisarmed: return {};
    default: return {Refusal::kState, -1, double(static_cast<int>(state_)), 0.0};
  }
}

// Taken at once, carried out by watch_reset().
Refused Core::reset() noexcept {
  const bool latched = state_ == State::kFault || state_ == State::kEstop;
  if (!latched || resetting_) return {Refusal::kState, -1, double(static_cast<int>(state_)), 0.0};
  resetting_ = true;
  reset_since_tick_ = tick_;
  return {};
}

Refused Core::set_speed(double value) noexcept {
  if (!(value > 0.0 && value <= 1.0)) return {Refusal::kMalformed, -1, value, 1.0};
  speed_ = value;
  if (state_ == State::kRun && motion_.target_rate() > 0.0) motion_.change_rate(allowed_speed());
  return {};
}

// A stop is never refused: an unknown cause number counts as an ordinary request. With the drives off there is nothing
// to stop, but whoever is about to arm and move has to hear of it.
void Core::take_stop(double value) noexcept {
  const bool plausible = value >= 1.0 && value <= 999.0;
  const auto cause = static_cast<Cause>(plausible ? static_cast<std::uint16_t>(value) : 0U);
  const Trip trip{cause != Cause::kNone && is_known(cause) ? cause : Cause::kStopRequested};
  if (state_ != State::kDisarmed) {
    stop(trip);
    return;
  }
  cause_ = trip;
  ++epoch_;
  emit(EventKind::kStopBegun, trip);
  emit(EventKind::kStopDone, trip);
}

void Core::take_plan() noexcept {
  for (PlanSlot& slot : shared_.plans) {
    if (slot.filled.load(std::memory_order_acquire) == 0 || slot.order != next_plan_order_) continue;
    ++next_plan_order_;
    const Plan& plan = slot.plan;
    if (const Refused refused = refuse(plan)) {
      reject(plan.id, refused);
      release_plans();
      return;
    }
    if (plan.parent_id != 0) {
      motion_.splice(plan);
      release_plans();  // one that it replaces
      Event event{.tick = tick_, .stamp_ns = now_ns_, .plan_id = plan.id, .value = plan.splice_t};
      event.kind = static_cast<std::uint16_t>(EventKind::kInfo);
      event.joint = -1;
      event.state = static_cast<std::uint8_t>(state_);
      events_.push(event);
      return;
    }
    cause_ = {};
    plan_id_ = plan.id;
    plan_t_ = 0.0;
    path_tolerance_ = plan.path_tolerance;
    plan_done_ = false;
    settling_ticks_ = 0;
    motion_.start(plan, allowed_speed());
    apply(Trigger::kPlanAccepted);
    emit(EventKind::kPlanStarted, {Cause::kNone, -1, plan.duration(), 0.0});
    return;
  }
}

Refused Core::refuse(const Plan& plan) noexcept {
  if (plan.epoch != epoch_) return {Refusal::kStale, -1, double(plan.epoch), double(epoch_)};
  if (front_end_lost_ || quit_) return {Refusal::kState, -1, double(static_cast<int>(state_)), 0.0};
  if (const Refused refused = check_plan(plan, config_)) return refused;
  return plan.parent_id == 0 ? refuse_start(plan) : refuse_splice(plan);
}

Refused Core::refuse_start(const Plan& plan) const noexcept {
  if (state_ != State::kHold || closing_brakes_ || reenabling_)
    return {Refusal::kState, -1, double(static_cast<int>(state_)), 3.0};
  for (int joint = 0; joint < config_.dof; ++joint) {
    const double error = plan.q[0][joint] - motion_.reference().q[joint];
    if (!(std::abs(error) <= kStartTolerance)) return {Refusal::kStart, joint, error, kStartTolerance};
  }
  return {};
}

Refused Core::refuse_splice(const Plan& plan) noexcept {
  if (state_ != State::kRun) return {Refusal::kState, -1, double(static_cast<int>(state_)), 4.0};
  const Plan& parent = *motion_.plan();
  if (plan.parent_id != parent.id) return {Refusal::kSplice, -1, double(plan.parent_id), double(parent.id)};
  if (!(plan.splice_t > motion_.plan_t() + dt_)) return {Refusal::kLate, -1, plan.splice_t, motion_.plan_t() + dt_};
  if (!(plan.splice_t <= parent.duration())) return {Refusal::kSplice, -1, plan.splice_t, parent.duration()};
  const PathPoint at = motion_.planned(plan.splice_t);
  for (int joint = 0; joint < config_.dof; ++joint) {
    const double p = plan.q[0][joint] - at.q[joint];
    const double v = plan.dq[0][joint] - at.dq[joint];
    const double a = plan.ddq[0][joint] - at.ddq[joint];
    if (!(std::abs(p) <= kSplicePosition)) return {Refusal::kSplice, joint, p, kSplicePosition};
    if (!(std::abs(v) <= kSpliceVelocity)) return {Refusal::kSplice, joint, v, kSpliceVelocity};
    if (!(std::abs(a) <= kSpliceAcceleration)) return {Refusal::kSplice, joint, a, kSpliceAcceleration};
  }
  return {};
}

void Core::reject(std::uint64_t plan_id, const Refused& refused) noexcept {
  Event event{.tick = tick_, .stamp_ns = now_ns_, .plan_id = plan_id, .value = refused.value, .limit = refused.limit};
  event.kind = static_cast<std::uint16_t>(EventKind::kRejected);
  event.cause = static_cast<std::uint16_t>(refused.code);
  event.joint = static_cast<std::int16_t>(refused.joint);
  event.state = static_cast<std::uint8_t>(state_);
  events_.push(event);
}

// SIGTERM and QUIT: stop on the path, disable, say so a few times, end. While a brake that has not closed keeps the arm
// under power, disarming is refused and asked for again in the next tick.
void Core::work_off_quit() noexcept {
  if (!quit_) return;
  const bool off = state_ == State::kDisarmed || ((state_ == State::kFault || state_ == State::kEstop) && !quick_stop_);
  if (!off)
    (void)disarm();
  else if (++quit_ticks_ > kQuitTicks)
    quit_done_ = true;
}

}  // namespace s2r
