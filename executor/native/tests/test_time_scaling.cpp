// The rate of path time, the on-path stop: against the law it must follow, integrated numerically.
#include <cmath>

#include "check.hpp"
#include "time_scaling.hpp"

namespace s2r {
namespace {

constexpr double kStep = 1e-3;
constexpr double kPeakSlope = 15.0 / 8.0;  // of S(x) = 6x^5 - 15x^4 + 10x^3
constexpr double kPeakCurvature = 5.7735026918962573;

bool close(double a, double b, double tolerance) { return std::abs(a - b) <= tolerance; }

double blend(double x) { return 6 * std::pow(x, 5) - 15 * std::pow(x, 4) + 10 * std::pow(x, 3); }
double slope(double x) { return 30 * std::pow(x, 4) - 60 * std::pow(x, 3) + 30 * std::pow(x, 2); }

// Path time from 0 to x of a blend, by Simpson's rule.
double covered(double r0, double r1, double x, double duration) {
  constexpr int kParts = 400;
  double sum = 0.0;
  for (int i = 0; i <= kParts; ++i) {
    const double weight = i == 0 || i == kParts ? 1.0 : i % 2 == 1 ? 4.0 : 2.0;
    sum += weight * (r0 + (r1 - r0) * blend(x * i / kParts));
  }
  return sum * x * duration / kParts / 3.0;
}

S2R_TEST(steady_path_time_runs_at_its_rate) {
  RateRamp ramp;
  for (const double rate : {1.0, 0.25, 0.0}) {
    if (rate != 1.0) ramp.reset(rate);
    CHECK(ramp.steady() && ramp.rate() == rate && ramp.target() == rate && ramp.rate_dot() == 0.0);
    for (int i = 0; i < 5; ++i) {
      const RateRamp::Step step = ramp.advance(kStep);
      CHECK(step.distance == rate * kStep && step.rate == rate && step.rate_dot == 0.0);
      CHECK(ramp.steady());
    }
    CHECK(ramp.distance_of_change(0.5, 0.8) == 0.5 * (rate + 0.5) * 0.8);
  }
}

S2R_TEST(a_change_from_a_steady_rate_follows_the_blend_and_ends_exactly) {
  for (const double r0 : {1.0, 0.4, 0.0})
    for (const double r1 : {0.0, 0.1, 1.0})  // 0.4 + (0.1 - 0.4) is not 0.1
      for (const double duration : {0.02, 0.1234, 0.5}) {
        if (r0 == r1) continue;
        RateRamp ramp;
        ramp.reset(r0);
        const double foretold = ramp.distance_of_change(r1, duration);
        ramp.change(r1, duration);
        CHECK(!ramp.steady() && ramp.target() == r1 && ramp.rate() == r0);
        double path_time = 0.0;
        const int last = static_cast<int>(std::ceil(duration / kStep - 1e-9));
        for (int i = 1; i <= last; ++i) {
          const RateRamp::Step step = ramp.advance(kStep);
          path_time += step.distance;
          const double x = i * kStep / duration;
          CHECK(step.rate == ramp.rate() && step.rate_dot == ramp.rate_dot());
          if (i == last) break;
          CHECK(!ramp.steady());
          CHECK(close(step.rate, r0 + (r1 - r0) * blend(x), 1e-12));
          CHECK(close(step.rate_dot, (r1 - r0) * slope(x) / duration, 1e-9));
          CHECK(close(path_time, covered(r0, r1, x, duration), 1e-9));
        }
        CHECK(ramp.steady() && ramp.rate() == r1 && ramp.rate_dot() == 0.0);
        CHECK(close(path_time, foretold + r1 * (last * kStep - duration), 1e-9));
      }
}

S2R_TEST(a_change_is_over_at_its_last_tick_and_not_one_later) {
  RateRamp ramp;
  ramp.change(0.0, 1.0);
  for (int i = 0; i < 4; ++i) {
    CHECK(!ramp.steady());
    ramp.advance(0.25);  // exact in binary
  }
  CHECK(ramp.steady());
}

S2R_TEST(a_change_begins_at_the_rate_the_last_one_reached) {
  RateRamp ramp;
  double from = 1.0;
  for (const double to : {0.0, 1.0, 0.4, 0.7}) {
    ramp.change(to, 0.2);
    CHECK(close(ramp.advance(kStep).rate, from + (to - from) * blend(0.005), 1e-12));
    for (int i = 1; i < 200; ++i) ramp.advance(kStep);
    CHECK(ramp.steady() && ramp.rate() == to);
    from = to;
  }
}

S2R_TEST(a_change_that_is_asked_for_twice_is_one_change) {
  RateRamp once, again;
  once.change(0.0, 0.4);
  again.change(0.0, 0.4);
  for (int i = 0; i < 450; ++i) {
    if (i % 50 == 10) again.change(0.0, 0.9);
    const RateRamp::Step a = once.advance(kStep), b = again.advance(kStep);
    CHECK(a.distance == b.distance && a.rate == b.rate && a.rate_dot == b.rate_dot);
  }
  RateRamp still;
  still.change(1.0, 0.4);
  CHECK(still.steady());
}

double lowest(const VelocityProfile& law) {
  double out = law.at(0.0).v;
  for (int i = 0; i * kStep < law.duration(); ++i) out = std::fmin(out, law.at(i * kStep).v);
  return out;
}

// Another wish in the middle of a change: no jump of rate or slope, never steeper or more bent than a whole ramp.
S2R_TEST(a_change_during_a_change_stays_twice_differentiable) {
  for (const int after : {1, 40, 120, 200, 290})
    for (const double back : {1.0, 0.5, 0.2})
      for (const double duration : {0.3, 0.6}) {
        RateRamp ramp;
        ramp.change(0.0, 0.3);
        for (int i = 0; i < after; ++i) ramp.advance(kStep);
        double rate = ramp.rate(), rate_dot = ramp.rate_dot();
        const double foretold = ramp.distance_of_change(back, duration);
        ramp.change(back, duration);
        CHECK(ramp.rate() == rate && ramp.rate_dot() == rate_dot && ramp.target() == back && !ramp.steady());
        const VelocityProfile law(rate, rate_dot, back, kPeakSlope / duration, kPeakCurvature / duration / duration);
        if (lowest(law) < 0.0) continue;  // would run backwards: the test below
        CHECK(close(foretold, law.distance(), 1e-9));
        double path_time = 0.0, t = 0.0;
        while (!ramp.steady()) {
          const RateRamp::Step step = ramp.advance(kStep);
          path_time += step.distance;
          t += kStep;
          CHECK(close(step.rate, law.at(t).v, 1e-9) && close(step.rate_dot, law.at(t).a, 1e-9));
          CHECK(t < law.duration() + 2 * kStep);
        }
        CHECK(t >= law.duration() - 1e-9 && ramp.rate() == back && ramp.rate_dot() == 0.0);
        CHECK(close(path_time, foretold + back * (t - law.duration()), 1e-9));
      }
}

// A change with a longer ramp must not carry the rate beyond where it came from, where it went and where it goes now.
S2R_TEST(a_change_during_a_change_that_gets_a_longer_ramp_goes_beyond_no_target) {
  for (const double r0 : {0.0, 0.4, 1.0})
    for (const double r1 : {0.0, 0.3, 1.0})
      for (const double r2 : {0.0, 0.2, 0.9, 1.0})
        for (const int after : {1, 30, 50, 80, 99}) {
          if (r0 == r1 || r1 == r2) continue;
          RateRamp ramp;
          ramp.reset(r0);
          ramp.change(r1, 0.1);
          for (int i = 0; i < after; ++i) ramp.advance(kStep);
          const double rate_dot = ramp.rate_dot(), foretold = ramp.distance_of_change(r2, 0.5);
          const double low = std::fmin(std::fmin(r0, r1), r2), high = std::fmax(std::fmax(r0, r1), r2);
          ramp.change(r2, 0.5);
          double path_time = 0.0, t = 0.0, last_dot = rate_dot;
          while (!ramp.steady()) {
            const RateRamp::Step step = ramp.advance(kStep);
            path_time += step.distance;
            t += kStep;
            CHECK(step.rate >= low - 1e-9 && step.rate <= high + 1e-9);
            CHECK(std::abs(step.rate_dot) <= std::fmax(std::abs(rate_dot), kPeakSlope / 0.5) + 1e-9);
            CHECK(std::abs(step.rate_dot - last_dot) <= kPeakCurvature / 0.1 / 0.1 * kStep * (1 + 1e-9));
            last_dot = step.rate_dot;
            CHECK(t < 1.5);
          }
          CHECK(ramp.rate() == r2 && ramp.rate_dot() == 0.0);
          CHECK(close(path_time, foretold, kStep));  // the last tick may end a little after the change
        }
}

S2R_TEST(a_reset_forgets_a_change_that_is_under_way) {
  RateRamp ramp;
  ramp.change(0.0, 0.4);
  for (int i = 0; i < 100; ++i) ramp.advance(kStep);
  ramp.reset(1.0);
  CHECK(ramp.steady() && ramp.rate() == 1.0 && ramp.rate_dot() == 0.0 && ramp.target() == 1.0);
  CHECK(ramp.advance(kStep).distance == kStep);
  ramp.change(0.0, 0.5);
  double path_time = 0.0;
  for (int i = 0; i < 500; ++i) path_time += ramp.advance(kStep).distance;
  CHECK(close(path_time, 0.25, 1e-9) && ramp.rate() == 0.0);
}

}  // namespace
}  // namespace s2r
