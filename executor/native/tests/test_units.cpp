// Gate, state machine and stop generator against what they must do, written down a second time and in another way.
// The mutation run (scripts/mutate) changes those units and expects these tests to notice.
#include <algorithm>
#include <cmath>
#include <memory>
#include <string_view>

#include "check.hpp"
#include "gate.hpp"
#include "joint_stop.hpp"
#include "state_machine.hpp"

namespace s2r {
namespace {

// --- state machine
// ----------------------------------------------------------------------------------------------------

// One row per state, one letter per trigger in the order of the enum: the state it leads to, '.' stays.
// B boot, D disarmed, A arming, H hold, R run, P paused, S stopping, 1 stop1, F fault, E e-stop.
constexpr std::string_view kLetters = "BDAHRPS1FE";
constexpr std::array<std::string_view, kStates> kExpected{
    // BADPEHR2100DRE : booted arm drives-enabled plan-accepted plan-ended path-halted resume cat2 cat1 cat0 at-rest
    // disarm reset estop
    "D........F...E",  // boot
    ".A...........E",  // disarmed
    "..H....DFF.D.E",  // arming
    "...R....1F.D.E",  // hold
    "....HP.S1F...E",  // run
    "......RS1F...E",  // paused
    "........1FH..E",  // stopping
    ".........FF..E",  // stop1
    "............DE",  // fault
    "............D.",  // e-stop
};

S2R_TEST(every_state_and_trigger_leads_where_the_table_says) {
  for (int state = 0; state < kStates; ++state) {
    const std::string_view row = kExpected[static_cast<std::size_t>(state)];
    CHECK(row.size() == static_cast<std::size_t>(kTriggers));
    for (int trigger = 0; trigger < kTriggers; ++trigger) {
      const char letter = row[static_cast<std::size_t>(trigger)];
      const State to = letter == '.' ? static_cast<State>(state) : static_cast<State>(kLetters.find(letter));
      CHECK(next_state(static_cast<State>(state), static_cast<Trigger>(trigger)) == to);
    }
  }
}

// --- gate
// ---------------------------------------------------------------------------------------------------------------

constexpr double kUnit = kRadPerCount;
constexpr double kTick = 1e-3;
constexpr double kMargin = 1.02;

Limits make_limits() {
  Limits limits;
  for (int joint = 0; joint < kMaxJoints; ++joint) {
    const double k = 1.00037 + 0.1 * joint;  // no bound is a whole number of counts
    limits.q_min[joint] = -2.0 * k;
    limits.q_max[joint] = 1.5 * k;
    limits.dq_max[joint] = 2.0 * k;
    limits.ddq_max[joint] = 6.0 * k;
    limits.dddq_max[joint] = 300.0 * k;
  }
  return limits;
}

struct Bed {
  explicit Bed(const Limits& limits = make_limits(), int dof = kMaxJoints, double dt = kTick, double margin = kMargin) {
    gate.configure(limits, dof, dt, margin);
  }
  // Positions sent before, oldest first, as counts of one joint; the others rest at zero. What was sent before those
  // lies far away, so that a gate which remembers a wrong one shows it.
  void sent(int joint, std::array<std::int32_t, 3> history) {
    EncodedSetpoint setpoint{};
    setpoint[joint].position = history[0] + 123'456;
    gate.reset(setpoint);
    for (const std::int32_t position : history) {
      setpoint[joint].position = position;
      gate.commit(setpoint);
    }
  }
  Trip next(int joint, std::int32_t position, std::int16_t velocity = 0, bool ok = true) const {
    EncodedSetpoint setpoint{};
    setpoint[joint] = {position, velocity, ok};
    return gate.check(setpoint);
  }
  Gate gate;
};

bool trips(const Trip& trip, Cause cause, int joint, double value, double limit) {
  const bool same_value = std::isnan(value) ? std::isnan(trip.value) : std::abs(trip.value - value) < 1e-6;
  return trip.cause == cause && trip.joint == joint && same_value && trip.limit == limit;
}

S2R_TEST(gate_passes_rest_and_names_a_number_that_does_not_fit) {
  const Limits limits = make_limits();
  for (int joint = 0; joint < kMaxJoints; ++joint) {
    const Bed bed;
    CHECK(!bed.next(joint, 0));
    CHECK(trips(bed.next(joint, 0, 0, false), Cause::kLimitPosition, joint, kNan, limits.q_max[joint]));
  }
}

// Position limits to the count: half a count of rounding is allowed, one count is not.
S2R_TEST(gate_holds_position_limits_to_the_count) {
  const Limits limits = make_limits();
  for (int joint = 0; joint < kMaxJoints; ++joint) {
    for (const bool upper : {false, true}) {
      const double limit = upper ? limits.q_max[joint] : limits.q_min[joint];
      const auto at = static_cast<std::int32_t>(std::lround(limit / kUnit));
      const int out = upper ? 1 : -1;
      Bed bed;
      bed.sent(joint, {at, at, at});
      CHECK(!bed.next(joint, at));
      CHECK(!bed.next(joint, at - out));
      CHECK(trips(bed.next(joint, at + out), Cause::kLimitPosition, joint, (at + out) * kUnit, limit));
    }
  }
}

// Rounding to a count may carry a legal position over its limit by half a count and no more.
S2R_TEST(gate_allows_half_a_count_of_rounding_beyond_a_position_limit) {
  for (const double beyond : {0.4, 0.5}) {  // the limit lies so many counts beyond count 1000
    Limits limits = make_limits();
    limits.q_max[2] = (1000 + beyond) * kUnit;
    limits.q_min[2] = -(1000 + beyond) * kUnit;
    for (const int sign : {-1, 1}) {
      Bed bed(limits);
      bed.sent(2, {sign * 1000, sign * 1000, sign * 1000});
      CHECK(!bed.next(2, sign * 1000));
      CHECK(static_cast<bool>(bed.next(2, sign * 1001)) == (beyond < 0.5));
    }
  }
}

// Every bound belongs to what is allowed: equal passes, in the gate's own arithmetic.
S2R_TEST(gate_counts_its_bounds_as_allowed) {
  const double half = 0.51 * kUnit;
  Limits limits = make_limits();
  limits.q_min[0] = half;  // q_min - half is zero exactly
  CHECK(!Bed(limits).next(0, 0));
  limits = make_limits();
  limits.q_max[0] = -half;
  CHECK(!Bed(limits).next(0, 0));
  for (auto field : {&Limits::dq_max, &Limits::ddq_max, &Limits::dddq_max}) {
    limits = make_limits();
    for (auto* loose : {&limits.dq_max, &limits.ddq_max, &limits.dddq_max}) (*loose)[0] = 1e12;
    (limits.*field)[0] = 0.0;  // what is left is the allowance for rounding: 1, 2, 4 counts
    const int counts = field == &Limits::dq_max ? 1 : field == &Limits::ddq_max ? 2 : 4;
    CHECK(!Bed(limits).next(0, counts) && !Bed(limits).next(0, -counts));
    CHECK(Bed(limits).next(0, counts + 1) && Bed(limits).next(0, -counts - 1));
  }
  limits = make_limits();
  limits.dq_max[0] = 0.5 * kRadPerSecondPerCount;
  CHECK(!Bed(limits, kMaxJoints, kTick, 1.0).next(0, 0, 1) && Bed(limits, kMaxJoints, kTick, 1.0).next(0, 0, 2));
  limits.dq_max[0] = 0.4 * kRadPerSecondPerCount;  // half a count of rounding reaches to 0.9, not to 1
  CHECK(Bed(limits, kMaxJoints, kTick, 1.0).next(0, 0, 1));
}

// The bound of an n-th difference is margin * limit plus what rounding may add, 2^n / 2 counts each way.
void sweep(Cause cause, int order, Joints Limits::* field) {
  const Limits limits = make_limits();
  for (int joint = 0; joint < kMaxJoints; ++joint) {
    for (const double dt : {kTick, 4e-3}) {
      const double limit = (limits.*field)[joint];
      const double slack = order == 1 ? 1 : order == 2 ? 2 : 4;
      const auto most = static_cast<std::int32_t>(std::floor(kMargin * limit * std::pow(dt, order) / kUnit + slack));
      for (const int sign : {-1, 1}) {
        Limits loose = limits;  // only the limit under test is tight
        for (auto* other : {&loose.dq_max, &loose.ddq_max, &loose.dddq_max}) (*other)[joint] = 1e12;
        (loose.*field)[joint] = limit;
        Bed bed(loose, kMaxJoints, dt);
        // A history whose difference of this order is all due to the next setpoint.
        const std::int32_t step = order == 1 ? 0 : 500;
        const std::int32_t bend = order == 3 ? 7 : 0;
        const std::int32_t p3 = 1000, p2 = p3 + step, p1 = p2 + step + bend;
        const std::int32_t predicted = order == 1 ? p1 : order == 2 ? p1 + (p1 - p2) : p1 + (p1 - p2) + bend;
        bed.sent(joint, {p3, p2, p1});
        CHECK(!bed.next(joint, predicted));
        CHECK(!bed.next(joint, predicted + sign * most));
        const double value = (most + 1) * sign * kUnit / std::pow(dt, order);
        const Trip trip = bed.next(joint, predicted + sign * (most + 1));
        CHECK(trip.cause == cause && trip.joint == joint && trip.limit == limit);
        CHECK(std::abs(trip.value - value) < 1e-6 * std::abs(value));
      }
    }
  }
}

S2R_TEST(gate_holds_velocity_to_the_count) { sweep(Cause::kLimitVelocity, 1, &Limits::dq_max); }
S2R_TEST(gate_holds_acceleration_to_the_count) { sweep(Cause::kLimitAcceleration, 2, &Limits::ddq_max); }
S2R_TEST(gate_holds_jerk_to_the_count) { sweep(Cause::kLimitJerk, 3, &Limits::dddq_max); }

S2R_TEST(gate_holds_the_velocity_field_to_the_count) {
  const Limits limits = make_limits();
  for (int joint = 0; joint < kMaxJoints; ++joint) {
    const double bound = kMargin * limits.dq_max[joint] / kRadPerSecondPerCount + 0.5;
    const auto most = static_cast<std::int16_t>(std::floor(bound + 1e-9));
    const Bed bed;
    for (const int sign : {-1, 1}) {
      CHECK(!bed.next(joint, 0, static_cast<std::int16_t>(sign * most)));
      const Trip trip = bed.next(joint, 0, static_cast<std::int16_t>(sign * (most + 1)));
      CHECK(trips(trip, Cause::kLimitVelocity, joint, sign * (most + 1) * kRadPerSecondPerCount, limits.dq_max[joint]));
    }
  }
}

S2R_TEST(gate_lets_no_limit_that_is_not_a_number_pass) {
  for (auto field : {&Limits::q_min, &Limits::q_max, &Limits::dq_max, &Limits::ddq_max, &Limits::dddq_max}) {
    Limits limits = make_limits();
    (limits.*field)[3] = kNan;
    const Bed bed(limits);
    CHECK(bed.next(3, 0).joint == 3);
  }
}

S2R_TEST(gate_looks_at_its_own_joints_only_and_names_the_first) {
  const Bed three(make_limits(), 3);
  CHECK(!three.next(3, 2'000'000'000));
  CHECK(three.next(2, 2'000'000'000).joint == 2);
  EncodedSetpoint two{};
  two[2].ok = two[5].ok = false;
  CHECK(Bed().gate.check(two).joint == 2);
}

// What was checked but not committed is forgotten; what was committed moves the history by one.
S2R_TEST(gate_remembers_what_was_sent_and_nothing_else) {
  Limits limits = make_limits();
  limits.ddq_max[0] = limits.dddq_max[0] = 1e12;
  Bed bed(limits);
  const auto most = static_cast<std::int32_t>(std::floor(kMargin * limits.dq_max[0] * kTick / kUnit + 1 + 1e-6));
  EncodedSetpoint setpoint{};
  for (int i = 0; i < 5; ++i) {
    setpoint[0].position += most;
    CHECK(!bed.gate.check(setpoint));
    CHECK(!bed.gate.check(setpoint));
    EncodedSetpoint further = setpoint;
    further[0].position += 1;
    CHECK(bed.gate.check(further).cause == Cause::kLimitVelocity);
    bed.gate.commit(setpoint);
  }
  bed.gate.reset({});
  CHECK(!bed.gate.check({}));
  CHECK(bed.gate.check(setpoint).cause == Cause::kLimitVelocity);
}

// --- stop generator
// -----------------------------------------------------------------------------------------------------

// Duration and distance of the time-optimal velocity change by another way: bisection over the peak acceleration.
struct Optimal {
  double duration, distance;
};

Optimal search(double v, double a, double v_end, double a_max, double j_max) {
  struct Phases {
    double dv, t, dp;
  };
  const auto play = [&](double peak, double hold) {
    Phases out{0.0, 0.0, 0.0};
    double speed = v, acceleration = a;
    const std::array<std::pair<double, double>, 3> phases{
        std::pair{std::abs(peak - a) / j_max, peak > a ? j_max : -j_max}, std::pair{hold, 0.0},
        std::pair{std::abs(peak) / j_max, peak > 0 ? -j_max : j_max}};
    for (const auto& [t, j] : phases) {
      out.dp += speed * t + acceleration * t * t / 2 + j * t * t * t / 6;
      speed += acceleration * t + j * t * t / 2;
      acceleration += j * t;
      out.t += t;
    }
    out.dv = speed - v;
    return out;
  };
  const double wanted = v_end - v;
  double low = -a_max, high = a_max;
  for (const double end : {low, high}) {
    const Phases full = play(end, 0.0);
    const double missing = wanted - full.dv;
    if (missing * end > 0.0) {
      const double hold = missing / end;
      const Phases held = play(end, hold);
      return {held.t, held.dp};
    }
  }
  for (int i = 0; i < 200; ++i) {
    const double middle = (low + high) / 2;
    (play(middle, 0.0).dv < wanted ? low : high) = middle;
  }
  const Phases found = play((low + high) / 2, 0.0);
  return {found.t, found.dp};
}

constexpr std::array kSpeeds{-3.0, -1.1, -0.05, -1e-4, 0.0, 2e-4, 0.03, 0.7, 2.9};
constexpr std::array kAccelerations{-6.0, -2.5, -0.1, 0.0, 0.2, 3.0, 6.0};

bool close(double a, double b, double tolerance) { return std::abs(a - b) <= tolerance; }

S2R_TEST(velocity_profile_is_the_fastest_inside_its_limits) {
  for (const double v : kSpeeds)
    for (const double a : kAccelerations)
      for (const double v_end : {0.0, 0.4, -1.0})
        for (const auto& [a_max, j_max] : {std::pair{6.0, 300.0}, std::pair{6.0, 20.0}, std::pair{0.3, 20.0}}) {
          const VelocityProfile profile(v, a, v_end, a_max, j_max);
          const Optimal optimal = search(v, a, v_end, a_max, j_max);
          CHECK(close(profile.duration(), optimal.duration, 1e-6));
          CHECK(close(profile.distance(), optimal.distance, 1e-6));
        }
}

S2R_TEST(velocity_profile_brings_an_acceleration_above_its_limit_down_first) {
  for (const double a : {7.0, 9.5, -8.0})
    for (const double v : {-2.0, 0.0, 1.0}) {
      const VelocityProfile profile(v, a, 0.0, 6.0, 300.0);
      const Optimal optimal = search(v, a, 0.0, 6.0, 300.0);
      CHECK(close(profile.duration(), optimal.duration, 1e-6) && close(profile.distance(), optimal.distance, 1e-6));
      CHECK(profile.at(1e-4).j == (a > 0.0 ? -300.0 : 300.0));
    }
}

S2R_TEST(velocity_profile_is_continuous_and_ends_where_it_should) {
  for (const double v : kSpeeds)
    for (const double a : kAccelerations)
      for (const double v_end : {0.0, 0.4}) {
        const VelocityProfile profile(v, a, v_end, 6.0, 300.0);
        const double T = profile.duration(), dt = T / 400;
        Motion1 last = profile.at(0.0);
        CHECK(last.p == 0.0 && last.v == v && last.a == a);
        CHECK(profile.at(-1.0).v == v);
        for (int i = 1; i <= 400 && T > 0.0; ++i) {
          const Motion1 now = profile.at(T * i / 400);
          CHECK(std::abs(now.a) <= 6.0 + 1e-9);
          CHECK(std::abs(now.a - last.a) <= 300.0 * dt + 1e-9);
          CHECK(std::abs(now.j) <= 300.0);
          CHECK(close(now.v - last.v, (now.a + last.a) / 2 * dt, 300.0 * dt * dt));
          CHECK(close(now.p - last.p, (now.v + last.v) / 2 * dt, 6.0 * dt * dt + 300.0 * dt * dt * dt));
          if (i < 400 && T > 1e-6) CHECK(now.j == 0.0 || std::abs(now.j) == 300.0);
          last = now;
        }
        const Motion1 end = profile.at(T), later = profile.at(T + 0.5);
        CHECK(end.v == v_end && end.a == 0.0 && end.j == 0.0);  // exact, not just close
        CHECK(later.v == v_end && later.a == 0.0 && later.j == 0.0);
        CHECK(close(later.p, profile.distance() + 0.5 * v_end, 1e-9));
        CHECK(close(end.p, profile.distance(), 1e-12));
      }
}

S2R_TEST(velocity_profile_begins_with_full_jerk_towards_its_goal) {
  const VelocityProfile brake(1.0, 0.0, 0.0, 6.0, 300.0), speed_up(0.0, 0.0, 1.0, 6.0, 300.0);
  CHECK(brake.at(1e-4).j == -300.0 && speed_up.at(1e-4).j == 300.0);
  CHECK(brake.at(brake.duration() / 2).j == 0.0 && brake.at(brake.duration() / 2).a == -6.0);
  CHECK(brake.at(brake.duration() - 1e-4).j == 300.0);
  const VelocityProfile nothing(0.0, 0.0, 0.0, 6.0, 300.0);
  CHECK(nothing.duration() == 0.0 && nothing.distance() == 0.0);
}

S2R_TEST(joint_stop_brakes_every_joint_by_itself_from_the_reference) {
  const Limits limits = make_limits();
  Reference from;
  for (int joint = 0; joint < kMaxJoints; ++joint) {
    from.q[joint] = 0.1 * joint - 0.2;
    from.dq[joint] = 0.3 * joint - 0.7;
    from.ddq[joint] = 1.0 - 0.4 * joint;
  }
  for (const int dof : {3, kMaxJoints}) {
    JointStop stop;
    stop.begin(from, limits, dof);
    double longest = 0.0;
    for (int joint = 0; joint < dof; ++joint) {
      const VelocityProfile alone(from.dq[joint], from.ddq[joint], 0.0, limits.ddq_max[joint], limits.dddq_max[joint]);
      longest = std::max(longest, alone.duration());
      CHECK(stop.duration(joint) == alone.duration());
      for (const double t : {0.0, 0.01, 0.05, 0.2, 2.0}) {
        const Reference at = stop.at(t);
        CHECK(at.q[joint] == from.q[joint] + alone.at(t).p);
        CHECK(at.dq[joint] == alone.at(t).v && at.ddq[joint] == alone.at(t).a);
      }
    }
    CHECK(stop.duration() == longest);
    for (int joint = dof; joint < kMaxJoints; ++joint) CHECK(stop.at(0.01).q[joint] == 0.0);
    from.dq = from.ddq = {};
    stop.begin(from, limits, dof);
    CHECK(stop.duration() == 0.0);
    for (int joint = 0; joint < kMaxJoints; ++joint)
      from.dq[joint] = 0.3 * joint - 0.7, from.ddq[joint] = 1.0 - 0.4 * joint;
  }
}

}  // namespace
}  // namespace s2r
