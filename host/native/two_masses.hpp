// A motor and the link it drives through a spring or through play, along a recorded motion of one joint.
//
// Link behind motor by d: T = k dz(d) + c d' where the flanks touch, and flanks push but never pull (Nordin and Gutman,
// Automatica 38(10), 2002). A gap of zero is a spring, which pulls as well.
#pragma once

#include <vector>

namespace s2r::gap {

// What hangs on the motor, a number per row of the record.
struct Link {
  const double* inertia = nullptr;
  const double* load = nullptr;   // effort it puts on a rigid gear, its inertia's share included
  const double* slope = nullptr;  // change of the load with the link's position
  const double* bend = nullptr;   // change of the slope with it
};

struct Gear {
  double stiffness = 0.0, damping = 0.0, gap = 0.0;  // gap: half width
  double effort(double windup, double rate) const noexcept;
};

// Effort that reaches the link, where the motor moves as recorded; a number per row.
// Steps are at most `phase` of the fastest motion long.
std::vector<double> behind_recorded_motor(int rows, double dt, const Link& link, const Gear& gear, double phase);

// How one row's windup and its rate lead to the next row's, a number per row each: the exact solution between them.
struct Steps {
  const double *windup, *windup_of_rate, *rate_of_windup, *rate, *windup_of_load, *rate_of_load;
};

// Effort that reaches a link behind a spring without play, where the motor moves as recorded; a number per row.
std::vector<double> hanging_link(int rows, double dt, const Steps& steps, const double* load, const double* bend,
                                 const Gear& gear);

// The law that holds the motor, with what it is told at every tick, `ticks` to a row.
struct Servo {
  double kp = 0.0, kd = 0.0, ki = 0.0;
  int ticks = 1;
  const double* q_cmd = nullptr;
  const double* dq_cmd = nullptr;
  const double* ahead = nullptr;
  double low = 0.0, high = 0.0;  // what the drive can give
  double integral = 0.0;         // as the record begins, in the integral's unit
  double follow = 0.0;           // 1/s: what else acts is found from the distance to the recorded motion, this fast
  bool reads_link = false;       // the encoder is behind the gear: position and speed of the law are the link's
};

struct Motor {
  double inertia = 0.0, damping = 0.0, friction = 0.0;
  double speed = 0.0;         // as the record begins
  const double* q = nullptr;  // recorded by the encoder, wherever it is, a number per row
};

// Position at the encoder, the effort that moves motor and link, friction taken off, and the motor's speed, at every
// row.
struct Driven {
  std::vector<double> q, effort, speed;
};

// The same with the motor under its servo; `link.load` is then without what the link's acceleration takes.
Driven under_servo(int rows, double dt, const Link& link, const Gear& gear, const Motor& motor, const Servo& servo,
                   double phase);

}  // namespace s2r::gap
