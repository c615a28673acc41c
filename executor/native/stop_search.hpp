// For admission, not for the loop: the shortest legal change of rate that may begin anywhere in a segment.
//
// Nothing is sampled in path time: a quintic's jerk can peak between two samples of any grid. The plan's derivatives
// are bounded over cells of path time, and while the rate passes through one step of the blend, wherever in the segment
// the blend began, path time lies in a known run of cells.
#pragma once

#include <span>
#include <vector>

#include "types.hpp"

namespace s2r {

// A plan as admission has it: power-basis coefficients in local time, lowest first, (segments x 6 x dof).
struct Polynomials {
  int dof = 0, segments = 0;
  const double *knots = nullptr, *coefficients = nullptr;
};

// What torque is made of on a uniform grid of path time (points x dof): standing still, what q'' and q'^2 add, M q'.
// It varies with the pose and has a margin of its own, so that it is sampled.
struct LoadGrid {
  int points = 0;
  double step_s = 0.0;
  const double *rest = nullptr, *path = nullptr, *inertia = nullptr;
};

struct BlendLimits {
  Joints ddq, dddq, tau;
};

// The segment that no blend can start in, and what the longest one needs there: largest absolute values.
struct NoBlend {
  int segment = -1;
  Joints ddq{}, dddq{}, tau{};
};

struct Blends {
  std::vector<double> durations;  // per segment [s]; NaN where there is none
  NoBlend none;                   // of the first such segment
};

// The path is cut into cells of cell_s, or longer ones where there were too many. durations: candidates, rising [s].
Blends find_blends(const Polynomials& plan, const LoadGrid& load, std::span<const double> durations,
                   const BlendLimits& limits, double cell_s);

}  // namespace s2r
