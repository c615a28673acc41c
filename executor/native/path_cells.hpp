// For admission: bounds on a plan's velocity, acceleration and jerk over cells of path time.
#pragma once

#include <vector>

#include "stop_search.hpp"

namespace s2r {

// The smallest and largest value per joint in each cell, (cells x dof).
struct Band {
  std::vector<double> low, high;
};

struct PathCells {
  int dof = 0, cells = 0, width = 1;
  double step_s = 0.0;
  Band dq, ddq, dddq;

  // Afterwards a cell's bounds are those of itself and the new_width - 1 after it, as far as there are any. They never
  // get narrower again.
  void widen(int new_width);
};

// Bounds of q'' and q''' are exact, those of q' wider than that by at most the square of a cell times jerk over 8.
PathCells path_cells(const Polynomials& plan, double step_s);

}  // namespace s2r
