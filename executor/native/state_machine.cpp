#include "state_machine.hpp"

namespace s2r {
namespace {

struct Transition {
  State from;
  Trigger trigger;
  State to;
};

constexpr std::array kTable{
    Transition{State::kBoot, Trigger::kBooted, State::kDisarmed},
    Transition{State::kBoot, Trigger::kStopCat0, State::kFault},

    Transition{State::kDisarmed, Trigger::kArm, State::kArming},

    Transition{State::kArming, Trigger::kDrivesEnabled, State::kHold},
    Transition{State::kArming, Trigger::kDisarm, State::kDisarmed},
    Transition{State::kArming, Trigger::kStopCat2, State::kDisarmed},
    Transition{State::kArming, Trigger::kStopCat1, State::kFault},
    Transition{State::kArming, Trigger::kStopCat0, State::kFault},

    Transition{State::kHold, Trigger::kPlanAccepted, State::kRun},
    Transition{State::kHold, Trigger::kDisarm, State::kDisarmed},
    Transition{State::kHold, Trigger::kStopCat1, State::kStop1},
    Transition{State::kHold, Trigger::kStopCat0, State::kFault},

    Transition{State::kRun, Trigger::kPlanEnded, State::kHold},
    Transition{State::kRun, Trigger::kPathHalted, State::kPaused},
    Transition{State::kRun, Trigger::kStopCat2, State::kStopping},
    Transition{State::kRun, Trigger::kStopCat1, State::kStop1},
    Transition{State::kRun, Trigger::kStopCat0, State::kFault},

    Transition{State::kPaused, Trigger::kResume, State::kRun},
    Transition{State::kPaused, Trigger::kStopCat2, State::kStopping},
    Transition{State::kPaused, Trigger::kStopCat1, State::kStop1},
    Transition{State::kPaused, Trigger::kStopCat0, State::kFault},

    Transition{State::kStopping, Trigger::kAtRest, State::kHold},
    Transition{State::kStopping, Trigger::kStopCat1, State::kStop1},
    Transition{State::kStopping, Trigger::kStopCat0, State::kFault},

    Transition{State::kStop1, Trigger::kAtRest, State::kFault},
    Transition{State::kStop1, Trigger::kStopCat0, State::kFault},

    Transition{State::kFault, Trigger::kReset, State::kDisarmed},
    Transition{State::kEstop, Trigger::kReset, State::kDisarmed},
};

}  // namespace

State next_state(State state, Trigger trigger) noexcept {
  if (trigger == Trigger::kEstopOpen) return State::kEstop;
  for (const Transition& row : kTable)
    if (row.from == state && row.trigger == trigger) return row.to;
  return state;
}

}  // namespace s2r
