// The real-time core: one tick, one setpoint. Everything is allocated with the object; tick() never allocates,
// locks, blocks or throws. Time comes in as an argument, so the same code runs under test, in simulation and on the
// arm.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>

#include "bus.hpp"
#include "gate.hpp"
#include "motion.hpp"
#include "packing.hpp"
#include "protective.hpp"
#include "shm.hpp"
#include "state_machine.hpp"
#include "types.hpp"
#include "watchdogs.hpp"

namespace s2r {

class Core {
 public:
  // Both must outlive the core. The block's configuration must have passed find_fault().
  // `first_tick`: where its counter begins; tests start it just before a wrap of the wire's 16 bits.
  Core(SharedBlock& shared, FramePort& port, bool realtime, std::uint64_t first_tick = 0) noexcept;
  ~Core();
  Core(const Core&) = delete;
  Core& operator=(const Core&) = delete;

  // One tick at monotonic time now_ns, which is lateness_ns after its deadline.
  void tick(std::int64_t now_ns, std::int64_t lateness_ns) noexcept;
  // The loop woke up so late that this many ticks passed without a setpoint; call before tick().
  void skip(std::uint64_t ticks, std::int64_t now_ns) noexcept;

  // Takes in what has arrived; tick() does it as well.
  void receive() noexcept;
  // Lock-step may go on: the stand-in has said that no more answers to the newest command will come or, on a bus that
  // never says so, every drive has answered.
  bool all_answered() const noexcept;
  // The loop is alive although tick() is not called (lock-step waits for a drive).
  void show_alive() noexcept { shared_.core_beats.fetch_add(1, std::memory_order_relaxed); }

  // Stop on the path, disable the drives, finish.
  void request_quit() noexcept { quit_ = true; }
  bool finished() const noexcept { return bus_closed_ || quit_done_; }
  bool ending_unpowered() const noexcept { return quit_ && state_ == State::kDisarmed; }
  bool bus_closed() const noexcept { return bus_closed_; }
  bool periods_announced() const noexcept { return periods_announced_; }
  State state() const noexcept { return state_; }

 private:
  // core.cpp: the parts of a tick
  void read() noexcept;
  void step() noexcept;
  void evaluate() noexcept;
  void check() noexcept;
  void write() noexcept;
  void publish(std::int64_t lateness_ns) noexcept;

  void hear_foreign_master() noexcept;
  void hear_bus_off() noexcept;
  void count_answers() noexcept;
  void listen_to_front_end() noexcept;
  void follow_measurement() noexcept;
  void build() noexcept;
  bool gate_passes() noexcept;
  void settle() noexcept;
  void settle_joint_stop() noexcept;
  void settle_goal() noexcept;

  // core_requests.cpp: what the front end asks for
  void take_commands() noexcept;
  void take_command(const Command& command) noexcept;
  Refused arm() noexcept;
  Cause unfit_bus() const noexcept;
  Refused disarm() noexcept;
  Refused reset() noexcept;
  Refused set_speed(double value) noexcept;
  void take_stop(double value) noexcept;
  void take_plan() noexcept;
  Refused refuse(const Plan& plan) noexcept;
  Refused refuse_start(const Plan& plan) const noexcept;
  Refused refuse_splice(const Plan& plan) noexcept;
  void reject(std::uint64_t plan_id, const Refused& refused) noexcept;
  void work_off_quit() noexcept;

  // core_stops.cpp: watchdogs, stops, transitions
  void watch() noexcept;
  Observed observed() const noexcept;
  void warn_late_answers() noexcept;
  void watch_estop() noexcept;
  void watch_powered() noexcept;
  void watch_warnings() noexcept;
  void close_brakes() noexcept;
  void watch_brakes() noexcept;
  void watch_reenabling() noexcept;
  void brakes_closed() noexcept;
  void brake_stays_open(int joint) noexcept;
  Trip find_following_error() const noexcept;
  void watch_arming() noexcept;
  void watch_disarmed() noexcept;
  void watch_reset() noexcept;
  void choose_request() noexcept;
  void stop(const Trip& trip) noexcept;  // by the category of its cause
  void act_on(const Finding& finding) noexcept;
  void drives_off(const Trip& trip) noexcept;  // category 0 whatever the cause
  void stop_with(const Trip& trip, Trigger trigger) noexcept;
  void apply(Trigger trigger) noexcept;
  void enter(State from) noexcept;
  void release_plans() noexcept;
  void emit(EventKind kind, const Trip& trip) noexcept;
  int first_in_fault() const noexcept;     // joint, -1 if none
  int first_not_enabled() const noexcept;  // joint, -1 if none
  int first_enabled() const noexcept;      // joint, -1 if none
  int first_unbraked() const noexcept;     // joint that its drive alone holds, -1 if none
  int oldest_answer() const noexcept;      // joint

  double allowed_speed() const noexcept { return slowed_ ? std::min(speed_, config_.warning_speed) : speed_; }
  bool powered() const noexcept { return is_powered(state_); }
  double path_tolerance() const noexcept;
  double goal_tolerance() const noexcept;
  double seconds_since(std::uint64_t tick) const noexcept { return dt_ * static_cast<double>(tick_ - tick); }

  SharedBlock& shared_;
  FramePort& port_;
  const Config config_;
  const double dt_;
  Ring<Command> commands_;
  Ring<Event> events_;
  Ring<Record> records_;

  PackingFd fd_{};
  PackingClassic classic_{};
  Packing* packing_ = nullptr;
  Gate gate_{};
  Motion motion_{};
  OverrunCounter overrun_counter_{};
  EstopChain estop_{};
  Plausibility plausibility_{};
  CollisionWatch collision_{};
  FollowingWindow window_{};
  ForeignLoad foreign_{};

  State state_ = State::kBoot;
  Trip cause_{};
  std::uint64_t epoch_ = 1;
  std::uint64_t tick_ = 0;
  std::int64_t now_ns_ = 0;
  double speed_ = 1.0;
  std::uint64_t state_since_tick_ = 0;
  bool disarm_pending_ = false;
  // Brakes before power: HOLD and a STOP1 at rest ask for "disable operation". When a brake does not close, HOLD goes
  // back to holding and STOP1 stays.
  bool closing_brakes_ = false, reenabling_ = false;
  std::uint64_t brakes_since_tick_ = 0;
  std::uint64_t enabled_ticks_ = 0;  // all drives enabled while arming, brakes may still open
  bool slowed_ = false;              // by a drive's warning
  bool quit_ = false, quit_done_ = false;
  std::uint64_t quit_ticks_ = 0;

  // plans
  std::uint64_t next_plan_order_ = 1;
  std::uint64_t plan_id_ = 0;
  double plan_t_ = 0.0;
  double path_tolerance_ = 0.0;  // of the plan that plays, or whose end is held; 0 = the configured one
  bool plan_done_ = false;
  std::uint64_t settling_ticks_ = 0;

  // drives
  DriveCommand command_{};  // being built
  DriveCommand sent_{};     // newest that left
  bool sent_any_ = false;
  bool command_complete_ = true;  // the newest command left in full: answers are due
  std::array<Frame, kMaxFramesPerTick> frames_{};
  int frame_count_ = 0;
  PerJoint<JointFeedback> drives_{};
  Ages age_{}, torque_age_{};
  PerJoint<std::uint64_t> warned_tick_{};
  Joints setpoint_q_{};  // of an unpowered or arming arm: the measured position
  Joints sent_q_ref_{};  // reference of the newest command
  Joints sent_tau_{};    // torque expected for it
  bool sent_tau_known_ = false;
  bool period_over_ = false;        // lock-step: no more answers to it will come
  bool periods_announced_ = false;  // lock-step: the bus has said so at least once
  std::uint64_t read_tick_ = 0;
  DriveRequest request_ = DriveRequest::kDisable;
  bool quick_stop_ = false;  // entered FAULT while moving
  bool resetting_ = false;
  std::uint64_t reset_since_tick_ = 0;

  // watchdog inputs
  std::uint64_t front_end_beats_ = 0;
  std::int64_t front_end_seen_ns_ = 0;
  std::uint64_t front_end_seen_tick_ = 0;
  bool front_end_lost_ = false;
  bool clock_started_ = false;
  std::uint32_t tx_failed_in_a_row_ = 0;
  bool foreign_master_ = false;
  std::uint64_t foreign_until_tick_ = 0;  // one that was heard counts as there until then
  bool bus_off_ = false;
  std::uint64_t bus_off_tick_ = 0;
  bool bus_closed_ = false;
  double stop1_guard_s_ = 1.0;
  double front_end_silence_s_ = 0.0;

  Snapshot snapshot_{};
};

}  // namespace s2r
