// The last check before a setpoint leaves: position, velocity, acceleration and jerk by backward differences of the
// encoded positions. It knows nothing of plans or splines, and it never repairs: a violation is a stop.
#pragma once

#include "packing.hpp"
#include "types.hpp"

namespace s2r {

class Gate {
 public:
  // dt: time between setpoints [s]. margin: factor on the v, a, j limits.
  void configure(const Limits& limits, int dof, double dt, double margin) noexcept;
  // The arm rests at this setpoint: nothing moved before it.
  void reset(const EncodedSetpoint& at_rest) noexcept;
  // The first violation of the setpoint that would follow the committed ones; no cause if it is legal.
  Trip check(const EncodedSetpoint& next) const noexcept;
  void commit(const EncodedSetpoint& sent) noexcept;

 private:
  Trip check_joint(int joint, const EncodedJoint& next) const noexcept;

  Limits limits_{};
  int dof_ = 0;
  double dt_ = 0.001, margin_ = 1.0;
  std::array<EncodedSetpoint, 3> sent_{};  // newest first
};

}  // namespace s2r
