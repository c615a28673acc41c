// Numbers that mean the same on every side: executor states, stop causes, refusals.
// The same numbers stand in s2r_protocol/faults.py; a test compares the two through the binding.
#pragma once

#include <array>
#include <cstdint>
#include <string_view>
#include <utility>

namespace s2r {

// How each state is entered and left: the table in state_machine.cpp.
enum class State : std::uint8_t {
  kBoot = 0,
  kDisarmed = 1,
  kArming = 2,
  kHold = 3,
  kRun = 4,
  kPaused = 5,
  kStopping = 6,
  kStop1 = 7,
  kFault = 8,
  kEstop = 9,
};
inline constexpr int kStates = 10;

// IEC 60204-1 words. This is software: it carries no performance level.
enum class StopCategory : std::uint8_t { kCat0 = 0, kCat1 = 1, kCat2 = 2, kNone = 9 };

enum class Cause : std::uint16_t {
  kNone = 0,
  kHostLost = 100,
  kFrontEndLost = 101,
  kFeedbackLost = 102,
  kBusOff = 103,
  kBusLoad = 104,
  kForeignMaster = 105,
  kTxFailed = 106,
  kOverrun = 107,
  kDriveFault = 200,
  kDriveNotEnabled = 201,
  kArmingTimeout = 202,
  kPlausibility = 203,
  kBrake = 204,
  kEstop = 205,
  kEstopDiscrepancy = 206,
  kInternal = 299,
  kLimitPosition = 300,
  kLimitVelocity = 301,
  kLimitAcceleration = 302,
  kLimitJerk = 303,
  kFollowing = 304,
  kCollision = 305,
  kOverTemperature = 306,
  kGoalTolerance = 307,
  kStopRequested = 400,
  kDisarmRequested = 401,
  kPauseRequested = 402,
};

enum class Refusal : std::uint16_t {
  kNone = 0,
  kMalformed = 1,
  kModel = 2,
  kStale = 3,
  kNoLease = 4,
  kState = 5,
  kNonfinite = 10,
  kTime = 11,
  kSize = 12,
  kStart = 13,
  kNotAtRest = 14,
  kPosition = 20,
  kVelocity = 21,
  kAcceleration = 22,
  kJerk = 23,
  kTorque = 24,
  kCollision = 25,
  kNoStopPath = 26,
  kLate = 30,
  kSplice = 31,
  kInternal = 99,
};

// What an entry of the event ring reports.
enum class EventKind : std::uint16_t {
  kState = 1,
  kPlanStarted = 2,
  kPlanDone = 3,
  kRejected = 4,
  kStopBegun = 5,
  kStopDone = 6,
  kGateTrip = 7,
  kOverrun = 8,
  kWatchdog = 9,
  kDrive = 10,
  kLatch = 11,
  kInfo = 12,
};

template <class Enum>
struct Named {
  std::string_view name;
  Enum value;
};

inline constexpr std::array<Named<State>, kStates> kStateNames{{
    {"BOOT", State::kBoot},
    {"DISARMED", State::kDisarmed},
    {"ARMING", State::kArming},
    {"HOLD", State::kHold},
    {"RUN", State::kRun},
    {"PAUSED", State::kPaused},
    {"STOPPING", State::kStopping},
    {"STOP1", State::kStop1},
    {"FAULT", State::kFault},
    {"ESTOP", State::kEstop},
}};

inline constexpr std::array<Named<StopCategory>, 4> kStopCategoryNames{{
    {"NONE", StopCategory::kNone},
    {"CAT0", StopCategory::kCat0},
    {"CAT1", StopCategory::kCat1},
    {"CAT2", StopCategory::kCat2},
}};

// One row per cause: its name and what the arm does about it (IEC 60204-1 stop category).
struct CauseRow {
  std::string_view name;
  Cause cause;
  StopCategory category;
};

inline constexpr std::array<CauseRow, 28> kCauses{{
    {"NONE", Cause::kNone, StopCategory::kNone},
    {"HOST_LOST", Cause::kHostLost, StopCategory::kCat2},
    {"FRONT_END_LOST", Cause::kFrontEndLost, StopCategory::kCat2},
    {"FEEDBACK_LOST", Cause::kFeedbackLost, StopCategory::kCat1},
    {"BUS_OFF", Cause::kBusOff, StopCategory::kCat1},
    {"BUS_LOAD", Cause::kBusLoad, StopCategory::kCat1},
    {"FOREIGN_MASTER", Cause::kForeignMaster, StopCategory::kCat1},
    {"TX_FAILED", Cause::kTxFailed, StopCategory::kCat1},
    {"OVERRUN", Cause::kOverrun, StopCategory::kCat1},
    {"DRIVE_FAULT", Cause::kDriveFault, StopCategory::kCat1},
    {"DRIVE_NOT_ENABLED", Cause::kDriveNotEnabled, StopCategory::kCat1},
    {"ARMING_TIMEOUT", Cause::kArmingTimeout, StopCategory::kCat0},
    {"PLAUSIBILITY", Cause::kPlausibility, StopCategory::kCat1},
    {"BRAKE", Cause::kBrake, StopCategory::kCat0},
    {"ESTOP", Cause::kEstop, StopCategory::kCat0},
    {"ESTOP_DISCREPANCY", Cause::kEstopDiscrepancy, StopCategory::kCat0},
    {"INTERNAL", Cause::kInternal, StopCategory::kCat1},
    {"LIMIT_POSITION", Cause::kLimitPosition, StopCategory::kCat1},
    {"LIMIT_VELOCITY", Cause::kLimitVelocity, StopCategory::kCat1},
    {"LIMIT_ACCELERATION", Cause::kLimitAcceleration, StopCategory::kCat1},
    {"LIMIT_JERK", Cause::kLimitJerk, StopCategory::kCat1},
    {"FOLLOWING", Cause::kFollowing, StopCategory::kCat1},
    {"COLLISION", Cause::kCollision, StopCategory::kCat1},
    {"OVER_TEMPERATURE", Cause::kOverTemperature, StopCategory::kCat1},
    {"GOAL_TOLERANCE", Cause::kGoalTolerance, StopCategory::kCat2},
    {"STOP_REQUESTED", Cause::kStopRequested, StopCategory::kCat2},
    {"DISARM_REQUESTED", Cause::kDisarmRequested, StopCategory::kCat2},
    {"PAUSE_REQUESTED", Cause::kPauseRequested, StopCategory::kCat2},
}};

// Category of a cause; a number that is not in the table is treated as an internal fault (category 1).
constexpr StopCategory category_of(Cause cause) noexcept {
  for (const CauseRow& row : kCauses)
    if (row.cause == cause) return row.category;
  return StopCategory::kCat1;
}

constexpr bool is_known(Cause cause) noexcept {
  for (const CauseRow& row : kCauses)
    if (row.cause == cause) return true;
  return false;
}

inline constexpr std::array<Named<Refusal>, 21> kRefusalNames{{
    {"NONE", Refusal::kNone},
    {"MALFORMED", Refusal::kMalformed},
    {"MODEL", Refusal::kModel},
    {"STALE", Refusal::kStale},
    {"NO_LEASE", Refusal::kNoLease},
    {"STATE", Refusal::kState},
    {"NONFINITE", Refusal::kNonfinite},
    {"TIME", Refusal::kTime},
    {"SIZE", Refusal::kSize},
    {"START", Refusal::kStart},
    {"NOT_AT_REST", Refusal::kNotAtRest},
    {"POSITION", Refusal::kPosition},
    {"VELOCITY", Refusal::kVelocity},
    {"ACCELERATION", Refusal::kAcceleration},
    {"JERK", Refusal::kJerk},
    {"TORQUE", Refusal::kTorque},
    {"COLLISION", Refusal::kCollision},
    {"NO_STOP_PATH", Refusal::kNoStopPath},
    {"LATE", Refusal::kLate},
    {"SPLICE", Refusal::kSplice},
    {"INTERNAL", Refusal::kInternal},
}};

inline constexpr std::array<Named<EventKind>, 12> kEventKindNames{{
    {"STATE", EventKind::kState},
    {"PLAN_STARTED", EventKind::kPlanStarted},
    {"PLAN_DONE", EventKind::kPlanDone},
    {"REJECTED", EventKind::kRejected},
    {"STOP_BEGUN", EventKind::kStopBegun},
    {"STOP_DONE", EventKind::kStopDone},
    {"GATE_TRIP", EventKind::kGateTrip},
    {"OVERRUN", EventKind::kOverrun},
    {"WATCHDOG", EventKind::kWatchdog},
    {"DRIVE", EventKind::kDrive},
    {"LATCH", EventKind::kLatch},
    {"INFO", EventKind::kInfo},
}};

}  // namespace s2r
