#include "time_scaling.hpp"

#include <cmath>

namespace s2r {
namespace {

constexpr double kPeakSlope = 15.0 / 8.0;             // max of S'
constexpr double kPeakCurvature = 5.773502691896258;  // max of |S''|, 10 / sqrt(3)

VelocityProfile moving_change(double rate, double rate_dot, double target, double duration) noexcept {
  return {rate, rate_dot, target, kPeakSlope / duration, kPeakCurvature / (duration * duration)};
}

}  // namespace

void RateRamp::reset(double rate) noexcept {
  *this = RateRamp{};
  rate_ = start_ = target_ = rate;
}

void RateRamp::change(double target, double duration) noexcept {
  if (target == target_) return;  // already there or on the way
  const bool moving = !steady();
  if (moving) profile_ = moving_change(rate_, rate_dot_, target, duration);
  start_ = rate_;
  target_ = target;
  t_ = 0.0;
  duration_ = moving ? profile_.duration() : duration;
  mode_ = moving ? Mode::kProfile : Mode::kBlend;
}

double RateRamp::distance_of_change(double target, double duration) const noexcept {
  if (steady()) return 0.5 * (rate_ + target) * duration;
  return moving_change(rate_, rate_dot_, target, duration).distance();
}

Motion1 RateRamp::at(double t) const noexcept {
  if (mode_ == Mode::kProfile) return profile_.at(t);
  const double x = std::fmin(t / duration_, 1.0), beyond = std::fmax(0.0, t - duration_);
  const double d = target_ - start_;
  const double s = x * x * x * (10.0 + x * (-15.0 + 6.0 * x));
  const double ds = 30.0 * x * x * (1.0 - x) * (1.0 - x);
  const double area = x * x * x * x * (2.5 + x * (-3.0 + x));
  return {.p = start_ * x * duration_ + d * duration_ * area + target_ * beyond,
          .v = start_ + d * s,
          .a = d * ds / duration_};
}

RateRamp::Step RateRamp::advance(double dt) noexcept {
  if (steady()) return {target_ * dt, target_, 0.0};
  const double before = at(t_).p;
  t_ += dt;
  const Motion1 now = at(t_);
  rate_ = now.v;
  rate_dot_ = now.a;
  if (t_ >= duration_) {
    rate_ = target_;  // the slope is zero by itself
    mode_ = Mode::kSteady;
  }
  return {now.p - before, rate_, rate_dot_};
}

}  // namespace s2r
