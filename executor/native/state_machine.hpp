// The executor's states as one table and a pure function. Effects happen in core.cpp, on entry.
#pragma once

#include <array>
#include <string_view>

#include "faults.hpp"

namespace s2r {

enum class Trigger : std::uint8_t {
  kBooted,         // configuration and bus are there
  kArm,            // a fresh, admitted ARM request
  kDrivesEnabled,  // every drive reports operation enabled
  kPlanAccepted,
  kPlanEnded,   // at rest, inside the goal tolerance
  kPathHalted,  // path time has come to a stand by a pause
  kResume,
  kStopCat2,  // controlled stop, power stays
  kStopCat1,  // controlled stop, then power off
  kStopCat0,  // power off now
  kAtRest,    // the stop under way has ended
  kDisarm,
  kReset,      // a RESET whose cause is gone
  kEstopOpen,  // the hardware chain is open
};
inline constexpr int kTriggers = 14;

inline constexpr std::array<Named<Trigger>, kTriggers> kTriggerNames{{
    {"BOOTED", Trigger::kBooted},
    {"ARM", Trigger::kArm},
    {"DRIVES_ENABLED", Trigger::kDrivesEnabled},
    {"PLAN_ACCEPTED", Trigger::kPlanAccepted},
    {"PLAN_ENDED", Trigger::kPlanEnded},
    {"PATH_HALTED", Trigger::kPathHalted},
    {"RESUME", Trigger::kResume},
    {"STOP_CAT2", Trigger::kStopCat2},
    {"STOP_CAT1", Trigger::kStopCat1},
    {"STOP_CAT0", Trigger::kStopCat0},
    {"AT_REST", Trigger::kAtRest},
    {"DISARM", Trigger::kDisarm},
    {"RESET", Trigger::kReset},
    {"ESTOP_OPEN", Trigger::kEstopOpen},
}};

// What is not in the table leaves the state as it is.
State next_state(State state, Trigger trigger) noexcept;

// Drives are enabled and follow the reference.
constexpr bool is_powered(State state) noexcept {
  return state == State::kHold || state == State::kRun || state == State::kPaused || state == State::kStopping ||
         state == State::kStop1;
}

}  // namespace s2r
