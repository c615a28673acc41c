// What the core checks of a plan by itself, whatever admission has said: it trusts numbers, not promises.
#pragma once

#include "types.hpp"

namespace s2r {

inline constexpr double kMinSegment_s = 1e-4, kMaxDuration_s = 3600.0;
inline constexpr double kMaxStop_s = 10.0;           // longest stop on the path
inline constexpr double kStartTolerance = 1e-4;      // [rad] between a plan's first knot and the reference
inline constexpr double kSplicePosition = 1e-6;      // [rad]
inline constexpr double kSpliceVelocity = 1e-5;      // [rad/s]
inline constexpr double kSpliceAcceleration = 1e-4;  // [rad/s2]

// Size, numbers, times, stop ramps, limits at the knots, rest at the end (and at the start unless it splices).
Refused check_plan(const Plan& plan, const Config& config) noexcept;

}  // namespace s2r
