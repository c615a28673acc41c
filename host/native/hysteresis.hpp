// States that remember which way a joint came, along the steps of a recorded motion.
#pragma once

#include <vector>

namespace s2r::gap {

// Slip in [-1, 1] that follows the steps and is held at its ends.
std::vector<double> held_slip(const double* step, int rows);

// Bouc-Wen's loop of a width: z' = dq (1 - |z|^power) while it builds up, dq (1 + (2 beta - 1) |z|^power) on the way
// back.
std::vector<double> hysteresis_loop(const double* step, int rows, double width, double power, double beta);

}  // namespace s2r::gap
