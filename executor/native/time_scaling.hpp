// The rate at which path time runs: 1 = as planned, 0 = standing still on the path.
#pragma once

#include "joint_stop.hpp"

namespace s2r {

// From a steady rate r0 the change is r0 + (r1 - r0) S(t / T), S(x) = 6x^5 - 15x^4 + 10x^3: the ramp that admission
// has checked. A change asked for while another is under way keeps rate and slope and uses the jerk-limited profile
// with the peak slope (15/8 / T) and curvature (10/sqrt(3) / T^2) of S, so it stays twice differentiable. The slope
// that was under way comes down sooner where a longer T would carry the rate beyond both targets: a stop during a
// resume must not speed the arm up first.
class RateRamp {
 public:
  struct Step {
    double distance;  // path time covered during the step [s]
    double rate;      // at its end
    double rate_dot;  // [1/s]
  };

  void reset(double rate) noexcept;
  // duration > 0: T of a whole ramp [s].
  void change(double target, double duration) noexcept;
  Step advance(double dt) noexcept;

  // Path time that change(target, duration) would cover until the new rate is reached [s].
  double distance_of_change(double target, double duration) const noexcept;

  double rate() const noexcept { return rate_; }
  double rate_dot() const noexcept { return rate_dot_; }
  double target() const noexcept { return target_; }
  bool steady() const noexcept { return mode_ == Mode::kSteady; }

 private:
  enum class Mode : unsigned char { kSteady, kBlend, kProfile };
  // A change that begins while another is under way: the slope down to zero where that needs more than the curvature of
  // S, then the rest.
  struct Turn {
    VelocityProfile level{}, rest{};
    double duration() const noexcept { return level.duration() + rest.duration(); }
    double distance() const noexcept { return level.distance() + rest.distance(); }
    Motion1 at(double t) const noexcept;
  };
  Turn turn_to(double target, double duration) const noexcept;
  Motion1 at(double t) const noexcept;  // of a change; p: path time since it began, v: rate, a: slope

  Mode mode_ = Mode::kSteady;
  double rate_ = 1.0, rate_dot_ = 0.0;
  double start_ = 1.0, target_ = 1.0;
  double low_ = 1.0, high_ = 1.0;  // what the change under way does not leave
  double t_ = 0.0, duration_ = 0.0;
  Turn turn_{};
};

}  // namespace s2r
