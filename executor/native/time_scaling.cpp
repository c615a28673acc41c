#include "time_scaling.hpp"

#include <cmath>

namespace s2r {
namespace {

constexpr double kPeakSlope = 15.0 / 8.0;             // max of S'
constexpr double kPeakCurvature = 5.773502691896258;  // max of |S''|, 10 / sqrt(3)
constexpr double kRounding = 1e-12;                   // of a rate; what is nearer to its end has next to no slope left

}  // namespace

void RateRamp::reset(double rate) noexcept {
  *this = RateRamp{};
  rate_ = start_ = target_ = low_ = high_ = rate;
}

Motion1 RateRamp::Turn::at(double t) const noexcept {
  if (t < level.duration()) return level.at(t);
  Motion1 m = rest.at(t - level.duration());
  m.p += level.distance();
  return m;
}

// The change under way would have brought its slope to zero inside [low, high]; so there is room for that.
RateRamp::Turn RateRamp::turn_to(double target, double duration) const noexcept {
  const double slope = kPeakSlope / duration, curvature = kPeakCurvature / (duration * duration);
  const double farthest = rate_dot_ > 0.0 ? std::fmax(high_, target) : std::fmin(low_, target);
  const double needed = rate_dot_ * rate_dot_ / (2.0 * std::fmax(std::abs(farthest - rate_), kRounding));
  Turn out;
  if (needed <= curvature) {
    out.rest = {rate_, rate_dot_, target, slope, curvature};
  } else {
    out.level = {rate_, rate_dot_, farthest, std::abs(rate_dot_), needed};
    out.rest = {farthest, 0.0, target, slope, curvature};
  }
  return out;
}

void RateRamp::change(double target, double duration) noexcept {
  if (target == target_) return;  // already there or on the way
  const bool moving = !steady();
  if (moving) turn_ = turn_to(target, duration);
  low_ = std::fmin(moving && rate_dot_ < 0.0 ? low_ : rate_, target);
  high_ = std::fmax(moving && rate_dot_ > 0.0 ? high_ : rate_, target);
  start_ = rate_;
  target_ = target;
  t_ = 0.0;
  duration_ = moving ? turn_.duration() : duration;
  mode_ = moving ? Mode::kProfile : Mode::kBlend;
}

double RateRamp::distance_of_change(double target, double duration) const noexcept {
  if (steady()) return 0.5 * (rate_ + target) * duration;
  return turn_to(target, duration).distance();
}

Motion1 RateRamp::at(double t) const noexcept {
  if (mode_ == Mode::kProfile) return turn_.at(t);
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
