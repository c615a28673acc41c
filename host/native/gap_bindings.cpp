#include "gap_bindings.hpp"

#include <nanobind/stl/tuple.h>

#include <tuple>
#include <utility>
#include <vector>

#include "arrays.hpp"
#include "filters.hpp"
#include "hysteresis.hpp"
#include "two_masses.hpp"

namespace s2r::gap {
namespace {

using namespace nb::literals;
using Rows = Doubles<1>;

Link link_of(const Rows& inertia, const Rows& load, const Rows& slope, const Rows& bend) {
  const std::size_t rows = inertia.shape(0);
  require(rows > 0 && load.shape(0) == rows && slope.shape(0) == rows && bend.shape(0) == rows,
          "inertia, load, slope and bend must have a number per row");
  for (std::size_t i = 0; i < rows; ++i) require(inertia.data()[i] > 0.0, "inertia must be positive");
  return {inertia.data(), load.data(), slope.data(), bend.data()};
}

Gear gear_of(double stiffness, double damping, double gap, double dt, double phase) {
  require(stiffness > 0.0 && damping >= 0.0 && gap >= 0.0 && dt > 0.0 && phase > 0.0,
          "stiffness, dt and phase must be positive, damping and gap not negative");
  return {stiffness, damping, gap};
}

Result behind(double dt, const Rows& inertia, const Rows& load, const Rows& slope, const Rows& bend, double stiffness,
              double damping, double gap, double phase) {
  const Link link = link_of(inertia, load, slope, bend);
  const Gear gear = gear_of(stiffness, damping, gap, dt, phase);
  const std::size_t rows = inertia.shape(0);
  return to_array(behind_recorded_motor(static_cast<int>(rows), dt, link, gear, phase), {rows});
}

std::tuple<Result, Result, Result> servoed(double dt, const Rows& inertia, const Rows& load, const Rows& slope,
                                           const Rows& bend, double stiffness, double damping, double gap,
                                           const Rows& q, double speed, double motor_inertia, double motor_damping,
                                           double friction, double kp, double kd, double ki, double low, double high,
                                           int ticks, const Rows& q_cmd, const Rows& dq_cmd, const Rows& ahead,
                                           double integral, double follow, bool reads_link, double phase) {
  const Link link = link_of(inertia, load, slope, bend);
  const Gear gear = gear_of(stiffness, damping, gap, dt, phase);
  const std::size_t rows = inertia.shape(0);
  require(motor_inertia > 0.0 && motor_damping >= 0.0 && friction >= 0.0,
          "the motor's inertia must be positive, its damping and friction not negative");
  require(kp >= 0.0 && kd >= 0.0 && ticks >= 1 && follow >= 0.0 && low <= high,
          "kp, kd and follow must not be negative, ticks one or more, low no more than high");
  require(q.shape(0) == rows, "q must have a number per row");
  const std::size_t told = rows * static_cast<std::size_t>(ticks);
  require(q_cmd.shape(0) == told && dq_cmd.shape(0) == told && ahead.shape(0) == told,
          "q_cmd, dq_cmd and ahead must have a number per tick");
  const Motor motor{motor_inertia, motor_damping, friction, speed, q.data()};
  const Servo servo{kp,           kd,  ki,   ticks,    q_cmd.data(), dq_cmd.data(),
                    ahead.data(), low, high, integral, follow,       reads_link};
  Driven found = under_servo(static_cast<int>(rows), dt, link, gear, motor, servo, phase);
  return {to_array(std::move(found.q), {rows}), to_array(std::move(found.effort), {rows}),
          to_array(std::move(found.speed), {rows})};
}

Result hanging(double dt, const Doubles<2>& steps, const Rows& load, const Rows& bend, double stiffness,
               double damping) {
  const std::size_t rows = load.shape(0);
  require(rows > 0 && bend.shape(0) == rows && steps.shape(0) == 6 && steps.shape(1) == rows,
          "load and bend must have a number per row, steps six");
  require(stiffness != 0.0, "stiffness must not be zero");
  const Gear gear{stiffness, damping, 0.0};
  const double* const s = steps.data();
  const Steps of{s, s + rows, s + 2 * rows, s + 3 * rows, s + 4 * rows, s + 5 * rows};
  return to_array(hanging_link(static_cast<int>(rows), dt, of, load.data(), bend.data(), gear), {rows});
}

Result held(const Rows& step) {
  return to_array(held_slip(step.data(), static_cast<int>(step.shape(0))), {step.shape(0)});
}

Result looped(const Rows& step, double width, double power, double beta) {
  require(width > 0.0 && power >= 1.0, "width must be positive, power one or more");
  return to_array(hysteresis_loop(step.data(), static_cast<int>(step.shape(0)), width, power, beta), {step.shape(0)});
}

Result both_ways(const Doubles<2>& x, const Doubles<2>& sections, const Doubles<2>& start, int pad) {
  const std::size_t rows = x.shape(0), columns = x.shape(1), count = sections.shape(0);
  require(rows > 0 && columns > 0, "x must have rows and columns");
  require(count > 0 && sections.shape(1) == 6, "sections must be six numbers each");
  require(start.shape(0) == count && start.shape(1) == 2, "start must be two numbers per section");
  require(pad >= 0 && static_cast<std::size_t>(pad) < rows, "pad must be less than the rows of x, and not negative");
  std::vector<Section> of;
  std::vector<SectionStart> from;
  for (std::size_t s = 0; s < count; ++s) {
    const double *c = sections.data() + 6 * s, *z = start.data() + 2 * s;
    require(c[3] == 1.0, "the fourth number of a section must be 1");
    of.push_back({c[0], c[1], c[2], c[3], c[4], c[5]});
    from.push_back({z[0], z[1]});
  }
  return to_array(forward_backward(x.data(), static_cast<int>(rows), static_cast<int>(columns), of, from, pad),
                  {rows, columns});
}

}  // namespace

void bind_gap(nb::module_& m) {
  m.def("hanging_link", &hanging, nb::kw_only(), "dt"_a, "steps"_a, "load"_a, "bend"_a, "stiffness"_a, "damping"_a,
        "Effort that reaches a link behind a spring, (rows,); see s2r_host.gap.motion.two_masses.");
  m.def("held_slip", &held, "step"_a, "Slip in [-1, 1] held at its ends, (rows,); see s2r_host.gap.motion.states.");
  m.def("hysteresis_loop", &looped, "step"_a, nb::kw_only(), "width"_a, "power"_a, "beta"_a,
        "State of a hysteresis loop along the steps, (rows,); see s2r_host.gap.motion.states.");
  m.def("forward_backward", &both_ways, nb::kw_only(), "x"_a, "sections"_a, "start"_a, "pad"_a,
        "Second-order sections forward and backward over the rows, (rows, columns); see s2r_host.gap.motion.filters.");
  m.def("behind_recorded_motor", &behind, nb::kw_only(), "dt"_a, "inertia"_a, "load"_a, "slope"_a, "bend"_a,
        "stiffness"_a, "damping"_a, "gap"_a, "phase"_a,
        "Effort that reaches a link behind a motor that moves as recorded, (rows,); see s2r_host.gap.motion.states.");
  m.def("under_servo", &servoed, nb::kw_only(), "dt"_a, "inertia"_a, "load"_a, "slope"_a, "bend"_a, "stiffness"_a,
        "damping"_a, "gap"_a, "q"_a, "speed"_a, "motor_inertia"_a, "motor_damping"_a, "friction"_a, "kp"_a, "kd"_a,
        "ki"_a, "low"_a, "high"_a, "ticks"_a, "q_cmd"_a, "dq_cmd"_a, "ahead"_a, "integral"_a, "follow"_a,
        "reads_link"_a, "phase"_a,
        "Position at the encoder of a motor under its servo, the effort that moves it and its link, and its speed,\n"
        "(rows,) each; see s2r_host.gap.motion.two_masses.");
}

}  // namespace s2r::gap
