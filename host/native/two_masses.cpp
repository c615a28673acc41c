#include "two_masses.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>

namespace s2r::gap {
namespace {

constexpr int kMostParts = 4000;  // of a tick: what is stiffer still is as good as rigid, and explodes

int parts_of(double step, double fastest, double phase) {
  // Limited before it is an int: a gear that is stiff enough asks for more parts than one holds.
  return static_cast<int>(std::fmin(std::fmax(std::ceil(fastest * step / phase), 1.0), kMostParts));
}

// What changes evenly between two rows, from a place between them on.
struct Even {
  double here, rate;
  Even(double first, double next, double share) : here(first + share * (next - first)), rate(next - first) {}
  Even(const double* x, int row, int rows, double share) : Even(x[row], x[std::min(row + 1, rows - 1)], share) {}
  double at(double later) const noexcept { return here + later * rate; }  // `later`: share of a row
};

// One over the inertia, which changes as evenly: a division in every part would take longest of all.
Even lightness_of(const Link& link, int row, int rows, double share) {
  return {1.0 / link.inertia[row], 1.0 / link.inertia[std::min(row + 1, rows - 1)], share};
}

}  // namespace

double Gear::effort(double windup, double rate) const noexcept {
  if (gap == 0.0) return stiffness * windup + damping * rate;
  if (windup > gap) return std::max(0.0, stiffness * (windup - gap) + damping * rate);
  if (windup < -gap) return std::min(0.0, stiffness * (windup + gap) + damping * rate);
  return 0.0;
}

std::vector<double> behind_recorded_motor(int rows, double dt, const Link& link, const Gear& gear, double phase) {
  std::vector<double> found(static_cast<std::size_t>(rows));
  const double lightest = *std::min_element(link.inertia, link.inertia + rows);
  const double fastest = std::max(std::sqrt(gear.stiffness / lightest), gear.damping / lightest);
  const int parts = parts_of(dt, fastest, phase);
  const double h = dt / parts;
  // The link hangs on the flank that its load at the beginning presses; windup is motor minus link.
  double windup = std::copysign(gear.gap, link.load[0]) + link.load[0] / gear.stiffness, rate = 0.0;
  for (int i = 0; i < rows; ++i) {
    const int from = std::max(i - 1, 0);
    const double share = i == 0 ? 0.0 : 1.0 / parts;  // from the row before to this one, a part
    const Even load{link.load, from, rows, 0.0}, slope{link.slope, from, rows, 0.0}, bend{link.bend, from, rows, 0.0};
    const Even lightness = lightness_of(link, from, rows, 0.0);
    for (int part = 0; part < parts; ++part) {
      const double later = (part + 0.5) * share;
      const double pull = load.at(later) - (slope.at(later) - 0.5 * bend.at(later) * windup) * windup;
      rate += h * (pull - gear.effort(windup, rate)) * lightness.at(later);
      windup += h * rate;
    }
    found[static_cast<std::size_t>(i)] = gear.effort(windup, rate);
  }
  return found;
}

std::vector<double> hanging_link(int rows, double dt, const Steps& steps, const double* load, const double* bend,
                                 const Gear& gear) {
  std::vector<double> found(static_cast<std::size_t>(rows));
  double windup = -load[0] / gear.stiffness, rate = 0.0;
  for (int i = 0; i < rows; ++i) {
    const double middle = windup + 0.5 * dt * rate, effort = load[i] + 0.5 * bend[i] * middle * middle;
    const double next = steps.windup[i] * windup + steps.windup_of_rate[i] * rate - steps.windup_of_load[i] * effort;
    rate = steps.rate_of_windup[i] * windup + steps.rate[i] * rate - steps.rate_of_load[i] * effort;
    windup = next;
    found[static_cast<std::size_t>(i)] = -gear.stiffness * windup - gear.damping * rate;
  }
  return found;
}

Driven under_servo(int rows, double dt, const Link& link, const Gear& gear, const Motor& motor, const Servo& servo,
                   double phase) {
  const std::vector<double> none(static_cast<std::size_t>(rows));
  Driven found{none, none, none};
  const double lightest = *std::min_element(link.inertia, link.inertia + rows);
  const double coupled = 1.0 / lightest + 1.0 / motor.inertia;
  const double fastest = std::max({std::sqrt(gear.stiffness * coupled), gear.damping * coupled,
                                   std::sqrt(servo.kp / motor.inertia), servo.kd / motor.inertia});
  const double tick = dt / servo.ticks;
  const int parts = parts_of(tick, fastest, phase);
  const double h = tick / parts, h_motor = h / motor.inertia, most_dry = h_motor * motor.friction;
  const double share = 1.0 / (static_cast<double>(parts) * servo.ticks);  // of a row, a part
  const double windup = std::copysign(gear.gap, link.load[0]) + link.load[0] / gear.stiffness;
  double q = motor.q[0] + (servo.reads_link ? windup : 0.0), q_link = q - windup;
  double v = motor.speed, v_link = v, integral = servo.integral, beside = 0.0;
  for (int i = 0; i < rows; ++i) {
    for (int k = 0; k < servo.ticks; ++k) {
      const int row = i * servo.ticks + k;
      const double seen = servo.reads_link ? q_link : q, speed = servo.reads_link ? v_link : v;
      integral += (servo.q_cmd[row] - seen) * tick;
      const double wanted =
          servo.kp * (servo.q_cmd[row] - seen) + servo.kd * (servo.dq_cmd[row] - speed) + servo.ahead[row];
      const double asked = std::clamp(wanted + servo.ki * integral, servo.low, servo.high);
      const double within = static_cast<double>(k) / servo.ticks;
      const Even recorded{motor.q, i, rows, within}, load{link.load, i, rows, within};
      const Even slope{link.slope, i, rows, within}, bend{link.bend, i, rows, within};
      const Even lightness = lightness_of(link, i, rows, within);
      beside += servo.follow * servo.kp * (recorded.here - seen) * tick;
      for (int part = 0; part < parts; ++part) {
        const double later = part * share;
        const double behind = q_link - recorded.at(later);  // of the recorded place, where the load is known
        const double pull = load.at(later) + (slope.at(later) + 0.5 * bend.at(later) * behind) * behind;
        const double through = gear.effort(q - q_link, v - v_link);
        const double drive = asked + beside - motor.damping * v;
        const double free = v + h_motor * (drive - through);
        const double dry = std::clamp(free, -most_dry, most_dry);
        if (k == 0 && part == 0) {
          const std::size_t here = static_cast<std::size_t>(i);
          found.q[here] = seen;
          found.effort[here] = drive - dry / h_motor;
          found.speed[here] = v;
        }
        v = free - dry;
        v_link += h * (through - pull) * lightness.at(later);
        q += h * v;
        q_link += h * v_link;
      }
    }
  }
  return found;
}

}  // namespace s2r::gap
