#include "spline.hpp"

#include <algorithm>
#include <cmath>

namespace s2r {

Quintic Quintic::hermite(double duration, const Motion1& start, const Motion1& end) noexcept {
  const double T = duration;
  const double v0 = start.v * T, v1 = end.v * T;
  const double a0 = start.a * T * T, a1 = end.a * T * T;
  const double d = end.p - start.p;
  Quintic out;
  out.duration_ = T;
  out.c_ = {start.p,
            v0,
            0.5 * a0,
            10.0 * d - 6.0 * v0 - 4.0 * v1 - 1.5 * a0 + 0.5 * a1,
            -15.0 * d + 8.0 * v0 + 7.0 * v1 + 1.5 * a0 - a1,
            6.0 * d - 3.0 * v0 - 3.0 * v1 - 0.5 * a0 + 0.5 * a1};
  return out;
}

Motion1 Quintic::at(double t) const noexcept {
  const double x = t / duration_, r = 1.0 / duration_;
  const auto& c = c_;
  return {
      .p = c[0] + x * (c[1] + x * (c[2] + x * (c[3] + x * (c[4] + x * c[5])))),
      .v = r * (c[1] + x * (2 * c[2] + x * (3 * c[3] + x * (4 * c[4] + x * 5 * c[5])))),
      .a = r * r * (2 * c[2] + x * (6 * c[3] + x * (12 * c[4] + x * 20 * c[5]))),
      .j = r * r * r * (6 * c[3] + x * (24 * c[4] + x * 60 * c[5])),
  };
}

void PlanCursor::open(const Plan& plan) noexcept {
  plan_ = &plan;
  segment_ = -1;
}

int PlanCursor::find(double s) const noexcept {
  const auto begin = plan_->t.begin(), end = begin + plan_->knots;
  const auto after = std::upper_bound(begin, end, s);
  return std::clamp(static_cast<int>(after - begin) - 1, 0, plan_->knots - 2);
}

void PlanCursor::load(int segment) noexcept {
  segment_ = segment;
  const auto i = static_cast<std::size_t>(segment);
  const double T = plan_->t[i + 1] - plan_->t[i];
  for (int joint = 0; joint < plan_->dof; ++joint)
    joints_[joint] = Quintic::hermite(T, {plan_->q[i][joint], plan_->dq[i][joint], plan_->ddq[i][joint], 0.0},
                                      {plan_->q[i + 1][joint], plan_->dq[i + 1][joint], plan_->ddq[i + 1][joint], 0.0});
}

PathPoint PlanCursor::at(double s) noexcept {
  const bool inside = segment_ >= 0 && plan_->time(segment_) <= s && s < plan_->time(segment_ + 1);
  if (!inside) {
    const int segment = find(s);
    if (segment != segment_) load(segment);
  }
  const double t = std::clamp(s, 0.0, plan_->duration()) - plan_->time(segment_);
  PathPoint out;
  for (int joint = 0; joint < plan_->dof; ++joint) {
    const Motion1 m = joints_[joint].at(t);
    out.q[joint] = m.p;
    out.dq[joint] = m.v;
    out.ddq[joint] = m.a;
    out.dddq[joint] = m.j;
  }
  return out;
}

// Along the path torque is rest + (what passing costs) * rate^2; the change of rate itself is left out.
Joints PlanCursor::torque(double s, double rate) const noexcept {
  const int segment = find(s);
  const auto i = static_cast<std::size_t>(segment);
  const double t0 = plan_->t[i], x = std::clamp((s - t0) / (plan_->t[i + 1] - t0), 0.0, 1.0);
  Joints out;
  for (int joint = 0; joint < plan_->dof; ++joint) {
    const double rest = std::lerp(plan_->tau_rest[i][joint], plan_->tau_rest[i + 1][joint], x);
    const double move = std::lerp(plan_->tau_move[i][joint], plan_->tau_move[i + 1][joint], x);
    out[joint] = rest + (move - rest) * rate * rate;
  }
  return out;
}

double PlanCursor::stop_duration(double s_from, double s_to) const noexcept {
  double longest = 0.0;
  for (int i = find(s_from); i < plan_->knots - 1 && (longest == 0.0 || plan_->time(i) < s_to); ++i)
    longest = std::max(longest, plan_->stop_duration[static_cast<std::size_t>(i)]);
  return longest;
}

}  // namespace s2r
