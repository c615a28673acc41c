// For admission, not for the loop: the shortest legal change of rate that may begin anywhere in a segment.
#pragma once

#include <cstddef>
#include <span>
#include <vector>

#include "types.hpp"

namespace s2r {

// One point of a blend of duration T: grid points since its start, and the rate with its first two derivatives.
struct BlendPoint {
  int offset = 0;
  double r = 0.0, dr = 0.0, ddr = 0.0;
};

// A plan on a uniform grid of path time: q', q'', q''' (points x dof); and on every stride-th point what torque is made
// of: standing still, what q'' and q'^2 add, M q'.
struct PathGrid {
  int dof = 0, points = 0, load_points = 0, load_stride = 1;
  const double *dq = nullptr, *ddq = nullptr, *dddq = nullptr;
  const double *rest = nullptr, *path = nullptr, *inertia = nullptr;
};

// One duration with its blend on both grids.
struct Candidate {
  double duration = 0.0;
  std::vector<BlendPoint> motion, load;
};

// The blend S(x) = 6x^5 - 15x^4 + 10x^3 over `duration`, sampled at up to 17 points of a grid of path time [s].
std::vector<BlendPoint> sample_blend(double duration, double step);

// For each segment [first, last] of grid points the shortest candidate for which a stop begun at any of its points, and
// a resume from a pause there, stays inside the limits; NaN where there is none. hint: shorter ones are not tried, but
// the last one always is.
std::vector<double> find_blends(const PathGrid& grid, std::span<const Candidate> candidates, const Joints& ddq_limit,
                                const Joints& dddq_limit, const Joints& tau_limit, std::span<const int> first,
                                std::span<const int> last, std::span<const double> hint);

}  // namespace s2r
