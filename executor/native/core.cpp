#include "core.hpp"

#include <algorithm>
#include <cmath>

namespace s2r {
namespace {

constexpr std::uint32_t kNever = 65535;   // age of a joint that has not answered yet
constexpr int kMaxFramesPerDrain = 1024;  // a babbling node must not hold the tick
constexpr double kForeignMasterStays_s = 0.1;

std::uint64_t ticks_per_second(std::int64_t tick_ns) noexcept {
  return static_cast<std::uint64_t>(1'000'000'000 / tick_ns);
}

}  // namespace

Core::Core(SharedBlock& shared, FramePort& port, bool realtime, std::uint64_t first_tick) noexcept
    : shared_(shared),
      port_(port),
      config_(shared.config),
      dt_(1e-9 * static_cast<double>(config_.tick_ns)),
      commands_(shared.commands()),
      events_(shared.events()),
      records_(shared.records()),
      tick_(first_tick),
      read_tick_(first_tick) {
  fd_.configure(config_.dof);
  classic_.configure(config_.dof, dt_);
  if (config_.packing == PackingKind::kFd)
    packing_ = &fd_;
  else
    packing_ = &classic_;
  gate_.configure(config_.limits, config_.dof, dt_, config_.gate_margin);
  motion_.configure(config_.limits, config_.dof, dt_);
  overrun_counter_.configure(config_.overrun_stop_count, ticks_per_second(config_.tick_ns));
  estop_.configure(config_.estop_discrepancy_s, dt_);
  plausibility_.configure(config_.limits, config_.dof, dt_, config_.frozen_rad);
  collision_.configure(config_.limits, config_.dof, config_.collision_share, config_.collision_ticks,
                       torque_every(config_.packing));
  window_.configure(config_.limits, config_.dof, dt_, config_.following_rest_share);
  for (int joint = 0; joint < config_.dof; ++joint) {
    const double a = config_.limits.ddq_max[joint], j = config_.limits.dddq_max[joint];
    stop1_guard_s_ = std::max(stop1_guard_s_, 1.5 * (config_.limits.dq_max[joint] / a + 2.0 * a / j));
    age_[joint] = torque_age_[joint] = kNever;
  }
  snapshot_.bus_load_computed = bus_load(config_.packing, config_.dof, config_.tick_ns);
  foreign_.configure(snapshot_.bus_load_computed, dt_);
  snapshot_.realtime = realtime ? 1 : 0;
  shared_.core_running.store(1, std::memory_order_release);
}

Core::~Core() { shared_.core_running.store(0, std::memory_order_release); }

void Core::tick(std::int64_t now_ns, std::int64_t lateness_ns) noexcept {
  now_ns_ = now_ns;
  read();
  step();
  evaluate();
  check();
  write();
  publish(lateness_ns);
  ++tick_;
}

// --- read ---------------------------------------------------------------------------------------------------------

void Core::read() noexcept {
  receive();
  foreign_.close_tick(tick_ - read_tick_);
  read_tick_ = tick_;
  count_answers();
  listen_to_front_end();
}

void Core::receive() noexcept {
  Frame frame;
  for (int i = 0; i < kMaxFramesPerDrain && !bus_closed_; ++i) {
    const Rx rx = port_.receive(frame);
    if (rx == Rx::kEmpty) return;
    if (rx == Rx::kClosed) {
      bus_closed_ = true;
      return;
    }
    if (!sent_any_ && !frame.error) continue;  // answers to somebody else's setpoints
    const RxResult result = packing_->unpack(frame, sent_, drives_);
    if (result.kind == RxKind::kCorrupt) ++snapshot_.crc_errors;
    if (result.kind == RxKind::kPeriodOver) period_over_ = periods_announced_ = true;
    if (result.kind == RxKind::kBusError && is_transmit_overflow(frame)) ++snapshot_.tx_failed;
    const bool foreign = result.kind == RxKind::kIgnored && result.joint < 0;
    if (foreign || result.kind == RxKind::kForeignMaster) foreign_.add(frame);
    if (result.kind == RxKind::kForeignMaster) hear_foreign_master();
    if (result.kind == RxKind::kBusOff) hear_bus_off();
    if (result.kind == RxKind::kEmergency) {
      const std::uint16_t error = drives_[result.joint].error;  // 0: one is gone
      emit(EventKind::kDrive, {error != 0U ? Cause::kDriveFault : Cause::kNone, result.joint, double(error), 0.0});
    }
  }
}

// One that sends more rarely than every tick is there between its frames as well.
void Core::hear_foreign_master() noexcept {
  foreign_master_ = true;
  foreign_until_tick_ = tick_ + static_cast<std::uint64_t>(std::ceil(kForeignMasterStays_s / dt_));
}

// While drives are on it is the cause of their stop. With none on nothing stops, but it is told.
void Core::hear_bus_off() noexcept {
  const bool told = bus_off_ || powered() || state_ == State::kArming;
  bus_off_ = true;
  bus_off_tick_ = tick_;
  if (!told) emit(EventKind::kWatchdog, {Cause::kBusOff, -1, 1.0, 0.0});
}

bool Core::all_answered() const noexcept {
  if (!command_complete_ || !sent_any_ || period_over_) return true;
  if (periods_announced_) return false;  // a drive's second frame (classical torque) may still be on its way
  for (int joint = 0; joint < config_.dof; ++joint)
    if (!drives_[joint].seen || drives_[joint].answered_tick != sent_.tick) return false;
  return true;
}

void Core::count_answers() noexcept {
  if (!sent_any_) return;
  const auto age_of = [&](bool seen, std::uint64_t tick) {
    const std::uint64_t age = seen ? sent_.tick - tick : kNever;
    return static_cast<std::uint32_t>(std::min<std::uint64_t>(age, kNever));
  };
  for (int joint = 0; joint < config_.dof; ++joint) {
    const JointFeedback& drive = drives_[joint];
    age_[joint] = age_of(drive.seen, drive.answered_tick);
    torque_age_[joint] = age_of(drive.seen, drive.torque_tick);
    if (age_[joint] > 0) ++snapshot_.late_answers;
  }
}

// The front end shows that it lives by counting up. In lock-step its silence is measured in ticks too: on a machine
// that stalls as a whole, nobody is late.
void Core::listen_to_front_end() noexcept {
  const std::uint64_t beats = shared_.beats.load(std::memory_order_relaxed);
  if (beats != front_end_beats_ || !clock_started_) {
    front_end_beats_ = beats;
    front_end_seen_ns_ = now_ns_;
    front_end_seen_tick_ = tick_;
    clock_started_ = true;
  }
  front_end_silence_s_ = 1e-9 * static_cast<double>(now_ns_ - front_end_seen_ns_);
  if (config_.clock == ClockKind::kLockstep)
    front_end_silence_s_ = std::min(front_end_silence_s_, seconds_since(front_end_seen_tick_));
}

// --- step ---------------------------------------------------------------------------------------------------------

void Core::step() noexcept {
  if (state_ == State::kBoot) apply(Trigger::kBooted);
  watch();
  take_commands();
  take_plan();
  work_off_quit();
  choose_request();
}

// --- evaluate -----------------------------------------------------------------------------------------------------

void Core::evaluate() noexcept {
  if (!powered()) {
    follow_measurement();
    return;
  }
  const Plan* before = motion_.plan();
  motion_.advance();
  if (motion_.plan() == before) return;
  plan_id_ = motion_.plan()->id;  // a spliced plan has taken over
  path_tolerance_ = motion_.plan()->path_tolerance;
  plan_done_ = false;
  emit(EventKind::kPlanStarted, {Cause::kNone, -1, motion_.plan()->duration(), 0.0});
  release_plans();
}

// Without power the setpoint is where the arm is, so that enabling a drive is no step. A drive that is already
// enabled while others are not keeps the setpoint it was enabled with.
void Core::follow_measurement() noexcept {
  for (int joint = 0; joint < config_.dof; ++joint) {
    const bool holds = state_ == State::kArming && drives_[joint].state == DriveState::kOperationEnabled;
    if (drives_[joint].seen && !holds) setpoint_q_[joint] = drives_[joint].q;
  }
}

// --- check --------------------------------------------------------------------------------------------------------

void Core::build() noexcept {
  command_.tick = tick_;
  command_.request = request_;
  command_.enables = state_ == State::kArming || reenabling_;
  const Reference rest{.q = setpoint_q_, .dq = {}, .ddq = {}};
  const Reference& reference = powered() ? motion_.next() : rest;
  for (int joint = 0; joint < config_.dof; ++joint)
    command_.setpoint[joint] = encode_joint(reference.q[joint], reference.dq[joint]);
  frame_count_ = packing_->pack(command_, drives_, frames_);
}

// The gate reads the setpoints back from the bytes that are about to leave.
bool Core::gate_passes() noexcept {
  EncodedSetpoint wire = packing_->setpoints(std::span(frames_).first(static_cast<std::size_t>(frame_count_)));
  for (int joint = 0; joint < config_.dof; ++joint) wire[joint].ok = command_.setpoint[joint].ok;
  const Trip trip = gate_.check(wire);
  if (!trip) {
    gate_.commit(wire);
    motion_.commit();
    return true;
  }
  emit(EventKind::kGateTrip, trip);
  if (state_ == State::kStop1)
    drives_off(trip);
  else
    stop(trip);
  return false;
}

// A refused setpoint never leaves. The joint-space stop takes its place in the same tick, from the last one that did.
void Core::check() noexcept {
  build();
  while (powered() && !gate_passes()) {
    choose_request();
    evaluate();
    build();
  }
  settle();
}

// What the reference has reached by now.
void Core::settle() noexcept {
  switch (state_) {
    case State::kRun:
      plan_t_ = motion_.plan_t();
      if (motion_.ended()) {
        settle_goal();
      } else if (motion_.halted()) {
        cause_ = {Cause::kPauseRequested};
        apply(Trigger::kPathHalted);
      }
      return;
    case State::kStopping:
      plan_t_ = motion_.plan_t();
      if (motion_.at_rest()) {
        emit(EventKind::kStopDone, cause_);
        apply(Trigger::kAtRest);
      }
      return;
    case State::kStop1: settle_joint_stop(); return;
    default: return;
  }
}

// At rest, the brakes close before the power goes; a stop that takes too long ends without them.
void Core::settle_joint_stop() noexcept {
  const bool too_long = seconds_since(state_since_tick_) > stop1_guard_s_;
  if (closing_brakes_ || !(motion_.at_rest() || too_long)) return;
  emit(EventKind::kStopDone, cause_);
  if (motion_.at_rest() && config_.brake_feedback)
    close_brakes();
  else
    apply(Trigger::kAtRest);
}

void Core::settle_goal() noexcept {
  int worst = 0;
  const auto error = [&](int joint) { return drives_[joint].q - motion_.reference().q[joint]; };
  for (int joint = 1; joint < config_.dof; ++joint)
    if (std::abs(error(joint)) > std::abs(error(worst))) worst = joint;
  const Trip goal{Cause::kGoalTolerance, worst, error(worst), goal_tolerance()};
  if (std::abs(goal.value) <= goal.limit && age_[oldest_answer()] == 0) {
    plan_done_ = true;
    emit(EventKind::kPlanDone, {Cause::kNone, worst, goal.value, goal.limit});
    apply(Trigger::kPlanEnded);
  } else if (dt_ * static_cast<double>(++settling_ticks_) > config_.goal_timeout_s) {
    stop(goal);
  }
}

// --- write --------------------------------------------------------------------------------------------------------

void Core::write() noexcept {
  const auto frames = std::span<const Frame>(frames_).first(static_cast<std::size_t>(frame_count_));
  for (const Frame& frame : frames)
    if (!packing_->tx_allowed(frame.id, frame.length, frame.fd)) {
      drives_off({Cause::kInternal, -1, double(frame.id), 0.0});
      return;
    }
  command_complete_ = port_.send(frames) == frame_count_;
  if (!command_complete_) {
    ++snapshot_.tx_failed;
    ++tx_failed_in_a_row_;
    return;
  }
  tx_failed_in_a_row_ = 0;
  period_over_ = false;
  packing_->sent();
  sent_ = command_;
  sent_any_ = true;
  ++command_.seq;
  sent_q_ref_ = powered() ? motion_.reference().q : setpoint_q_;
  sent_tau_known_ = powered() && motion_.knows_torque();
  if (sent_tau_known_) sent_tau_ = motion_.expected_torque();
  window_.advance(powered() ? motion_.reference().dq : Joints{});
}

void Core::publish(std::int64_t lateness_ns) noexcept {
  const Reference rest{.q = setpoint_q_, .dq = {}, .ddq = {}};
  const Reference& reference = powered() ? motion_.reference() : rest;
  Snapshot& s = snapshot_;
  s.tick = tick_;
  s.stamp_ns = now_ns_;
  s.epoch = epoch_;
  s.plan_id = plan_id_;
  s.next_plan_id = motion_.child() != nullptr ? motion_.child()->id : 0;
  s.bus_load_foreign = foreign_.load();
  s.plan_t = plan_t_;
  s.plan_done = plan_done_ ? 1 : 0;
  s.speed_scale = motion_.has_plan() ? motion_.rate() : allowed_speed();
  s.speed_set = speed_;
  s.state = static_cast<std::uint8_t>(state_);
  s.cause = static_cast<std::uint16_t>(cause_.cause);
  s.cause_joint = static_cast<std::int16_t>(cause_.joint);
  s.cause_value = cause_.value;
  s.cause_limit = cause_.limit;
  s.q_ref = reference.q;
  s.dq_ref = reference.dq;
  s.ddq_ref = reference.ddq;
  for (int joint = 0; joint < config_.dof; ++joint) {
    s.q_meas[joint] = drives_[joint].q;
    s.dq_meas[joint] = drives_[joint].dq;
    s.tau_meas[joint] = drives_[joint].tau;
    s.drive_state[joint] = static_cast<std::uint8_t>(drives_[joint].state);
  }
  s.feedback_age = age_;
  shared_.snapshot.write(s);
  records_.push({.tick = tick_,
                 .stamp_ns = now_ns_,
                 .lateness_ns = lateness_ns,
                 .plan_id = plan_id_,
                 .plan_t = plan_t_,
                 .speed_scale = s.speed_scale,
                 .q_ref = s.q_ref,
                 .dq_ref = s.dq_ref,
                 .ddq_ref = s.ddq_ref,
                 .q_meas = s.q_meas,
                 .dq_meas = s.dq_meas,
                 .tau_meas = s.tau_meas,
                 .cause = s.cause,
                 .state = s.state});
  show_alive();
}

// --- late wake-ups ------------------------------------------------------------------------------------------------

// Drives bridge up to drive_extrapolation_ticks missing setpoints at constant velocity. The reference passes through
// that time with them (evaluated and gated, not sent), so the next setpoint continues what they did. A longer gap has
// made them stop by themselves: path time stays where it was and the arm stops. Nothing is ever sent late.
void Core::skip(std::uint64_t ticks, std::int64_t now_ns) noexcept {
  now_ns_ = now_ns;
  ++snapshot_.overruns;
  snapshot_.missed += ticks;
  const bool bridged = ticks <= static_cast<std::uint64_t>(config_.drive_extrapolation_ticks);
  const Trip trip{Cause::kOverrun, -1, double(ticks), double(config_.drive_extrapolation_ticks)};
  emit(EventKind::kOverrun, trip);
  for (std::uint64_t i = 0; bridged && i < ticks && powered(); ++i) {
    evaluate();
    check();
  }
  tick_ += ticks;
  const bool too_often = overrun_counter_.add(tick_);
  if (powered() && (!bridged || too_often)) stop(trip);
}

}  // namespace s2r
