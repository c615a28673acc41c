// Plain data shared by all units. No behaviour, no pointers: most of it lives in shared memory.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <limits>

#include "faults.hpp"

namespace s2r {

inline constexpr int kMaxJoints = 7;    // slots of the packed SET frame
inline constexpr int kMaxKnots = 4096;  // of one plan
inline constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

// Indexing by joint with the int that a loop over `dof` wants, without sign warnings at every use.
template <class T>
struct PerJoint : std::array<T, static_cast<std::size_t>(kMaxJoints)> {
  using Base = std::array<T, static_cast<std::size_t>(kMaxJoints)>;
  constexpr T& operator[](int joint) noexcept { return Base::operator[](static_cast<std::size_t>(joint)); }
  constexpr const T& operator[](int joint) const noexcept { return Base::operator[](static_cast<std::size_t>(joint)); }
};
using Joints = PerJoint<double>;

// Commanded state of all joints: q [rad], dq [rad/s], ddq [rad/s2].
struct Reference {
  Joints q{}, dq{}, ddq{};
};

struct Limits {
  Joints q_min{}, q_max{};  // [rad]
  Joints dq_max{};          // [rad/s]
  Joints ddq_max{};         // [rad/s2]
  Joints dddq_max{};        // [rad/s3]
  Joints tau_max{};         // [N m]
};

// Why something was stopped or refused; joint = -1: none in particular.
struct Trip {
  Cause cause = Cause::kNone;
  int joint = -1;
  double value = 0.0;
  double limit = 0.0;
  constexpr explicit operator bool() const noexcept { return cause != Cause::kNone; }
};

// Why a command was not taken; the limit is what it was compared with.
struct Refused {
  Refusal code = Refusal::kNone;
  int joint = -1;
  double value = 0.0;
  double limit = 0.0;
  constexpr explicit operator bool() const noexcept { return code != Refusal::kNone; }
};

enum class PackingKind : std::uint32_t { kFd = 0, kClassic = 1 };
enum class ClockKind : std::uint32_t { kReal = 0, kLockstep = 1 };

// Checked by config.cpp before it reaches the core.
struct Config {
  int dof = 0;
  std::int64_t tick_ns = 0;
  PackingKind packing = PackingKind::kFd;
  ClockKind clock = ClockKind::kLockstep;
  double pace = 1.0;  // lock-step only: at most this many times the wall clock while busy, 0 = as fast as possible
  std::array<char, 256> bus{};
  Limits limits{};
  double gate_margin = 1.02;          // factor on the velocity, acceleration and jerk limits
  double path_tolerance_rad = 0.05;   // largest following error
  double goal_tolerance_rad = 0.02;   // at the end of a plan
  double goal_timeout_s = 2.0;        // to get inside the goal tolerance
  int feedback_warn_ticks = 1;        // age of an answer: event
  int feedback_stop_ticks = 3;        // age of an answer: joint-space stop
  int feedback_fault_ticks = 10;      // age of an answer: drives off
  double front_end_timeout_s = 0.1;   // silence of the front end: stop on the path
  double answer_timeout_s = 1.0;      // lock-step only, wall time, if the bus does not say when a period is over
  double arming_timeout_s = 2.0;      // for all drives to reach operation enabled
  double quit_timeout_s = 10.0;       // after SIGTERM or SIGINT, wall time: to come to rest and switch off
  int realtime_priority = 80;         // SCHED_FIFO; 0 = do not ask
  int cpu = -1;                       // the only one that the process runs on; -1 = wherever the kernel puts it
  bool allow_not_realtime = false;    // on a can: bus
  int record_capacity = 65536;        // ticks kept for the front end
  int drive_extrapolation_ticks = 3;  // missing setpoints that a drive bridges at constant velocity
  int overrun_stop_count = 3;         // late wake-ups within one second: joint-space stop
  double following_rest_share = 0.5;  // of the path tolerance, for a joint at rest
  double frozen_rad = 0.004;          // travel of the reference with not one count of measured motion: stop
  double collision_share = 0.5;       // of tau_max: torque away from the plan's that counts as contact
  int collision_ticks = 5;            // so long outside, in fresh samples in a row: joint-space stop
  int temperature_warn_C = 70;        // slow down
  int temperature_stop_C = 85;        // joint-space stop
  double warning_speed = 0.5;         // rate of path time while a drive warns
  bool brake_feedback = true;         // drives report their brakes
  double brake_timeout_s = 0.3;       // for brakes to open and close
  double estop_discrepancy_s = 0.05;  // the two channels may disagree for so long
};

// A timed quintic spline. Knot i: t[i] [s], q[i], dq[i], ddq[i]; stop_duration[i] [s] belongs to segment i.
struct Plan {
  std::uint64_t id = 0;
  std::uint64_t epoch = 0;
  std::uint64_t parent_id = 0;  // 0 = starts from rest at the reference
  double splice_t = 0.0;        // path time of the parent at which this plan begins [s]
  double path_tolerance = 0.0;  // [rad], 0 = the configured one
  double goal_tolerance = 0.0;  // [rad], 0 = the configured one
  int knots = 0;
  int dof = 0;
  std::array<double, kMaxKnots> t{};
  std::array<Joints, kMaxKnots> q{}, dq{}, ddq{};
  std::array<double, kMaxKnots> stop_duration{};
  bool has_torque = false;                               // the next two are filled
  std::array<Joints, kMaxKnots> tau_rest{}, tau_move{};  // torque standing at a knot and passing it as planned [N m]

  double time(int knot) const noexcept { return t[static_cast<std::size_t>(knot)]; }
  double duration() const noexcept { return time(knots - 1); }
};

// Numbers of s2r.proto ControlKind; kQuit is between front end and core only.
enum class CommandKind : std::uint32_t {
  kUnspecified = 0,
  kArm = 1,
  kDisarm = 2,
  kStop = 3,
  kPause = 4,
  kResume = 5,
  kSetSpeed = 6,
  kReset = 7,
  kQuit = 100,
};

struct Command {
  CommandKind kind = CommandKind::kUnspecified;
  std::uint32_t reserved = 0;
  std::uint64_t epoch = 0;
  double value = 0.0;
};

// One per tick.
struct Record {
  std::uint64_t tick = 0;
  std::int64_t stamp_ns = 0;
  std::int64_t lateness_ns = 0;
  std::uint64_t plan_id = 0;
  double plan_t = 0.0;
  double speed_scale = 0.0;
  Joints q_ref{}, dq_ref{}, ddq_ref{}, q_meas{}, dq_meas{}, tau_meas{};
  std::uint16_t cause = 0;
  std::uint8_t state = 0;
  std::array<std::uint8_t, 5> reserved{};
};

struct Event {
  std::uint64_t tick = 0;
  std::int64_t stamp_ns = 0;
  std::uint64_t plan_id = 0;
  double value = 0.0;
  double limit = 0.0;
  std::uint16_t kind = 0;
  std::uint16_t cause = 0;  // Refusal for REJECTED, Cause otherwise
  std::int16_t joint = -1;
  std::uint8_t state = 0;
  std::uint8_t reserved = 0;
};

struct Snapshot {
  std::uint64_t tick = 0;
  std::int64_t stamp_ns = 0;
  std::uint64_t epoch = 0;
  std::uint64_t plan_id = 0;
  std::uint64_t next_plan_id = 0;  // waits for its splice point; 0 = none
  double plan_t = 0.0;
  double speed_scale = 1.0;  // rate of path time now
  double speed_set = 1.0;    // the rate that was asked for
  double cause_value = 0.0;
  double cause_limit = 0.0;
  Joints q_ref{}, dq_ref{}, ddq_ref{}, q_meas{}, dq_meas{}, tau_meas{};
  std::uint64_t overruns = 0;      // late wake-ups that lost at least one tick
  std::uint64_t missed = 0;        // ticks lost by them
  std::uint64_t tx_failed = 0;     // ticks whose setpoint did not leave
  std::uint64_t crc_errors = 0;    // frames with a wrong checksum, length or counter
  std::uint64_t late_answers = 0;  // drive answers that were not there when they were due
  double bus_load_computed = 0.0;
  double bus_load_foreign = 0.0;           // frames that are none of ours, as heard
  PerJoint<std::uint32_t> feedback_age{};  // [ticks]
  PerJoint<std::uint8_t> drive_state{};    // CiA 402, numbered as in the STAT frame
  std::uint8_t state = 0;
  std::uint16_t cause = 0;
  std::int16_t cause_joint = -1;
  std::uint8_t plan_done = 0;
  std::uint8_t realtime = 0;
  std::array<std::uint8_t, 3> reserved{};
};

}  // namespace s2r
