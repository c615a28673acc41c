#include "rewards.hpp"

#include <algorithm>
#include <cmath>

namespace s2r::planning {
namespace {

constexpr double kHingeSpeedShare = 0.04;  // a hinge at 5 rad/s is as fast as a slide at 1 m/s

constexpr double square(double x) noexcept { return x * x; }

}  // namespace

double r_dist(double distance_m, double turn_rad, const RewardWeights& weights) noexcept {
  const double width = weights.distance_width_m;
  const double squared = square(distance_m) + square(weights.turn_m * turn_rad);
  return -weights.distance * 2.0 * square(width) * (std::sqrt(1.0 + squared / square(width)) - 1.0);
}

double remaining(double s, const Task& task) noexcept {
  return std::abs(task.s_target - s) / std::abs(task.s_target - task.s_initial);
}

double r_target(double s, const Task& task, const RewardWeights& weights) noexcept {
  return -weights.target * remaining(s, task);
}

bool on_target(double s, const Task& task) noexcept { return std::abs(task.s_target - s) < task.tolerance; }

double r_success(double s, const Task& task, const RewardWeights& weights) noexcept {
  return on_target(s, task) ? weights.success : 0.0;
}

double r_contact(double s, bool touches, bool collides, const Task& task, const RewardWeights& weights) noexcept {
  if (collides) return -weights.collision;
  if (!touches) return 0.0;
  if (on_target(s, task)) return -weights.contact_after;
  const double band = task.tolerance / std::abs(task.s_target - task.s_initial);
  return remaining(s, task) < 1.0 - band ? weights.contact : 0.0;
}

double r_reg(std::span<const double> dq, std::span<const double> ddq, const RewardWeights& weights) noexcept {
  double sum = 0.0;
  for (std::size_t j = 0; j < dq.size(); ++j)
    sum += weights.joints[j] * (weights.acceleration * std::abs(ddq[j]) + weights.speed * std::abs(dq[j]));
  return -sum;
}

double r_calm(double ds, const Task& task, const RewardWeights& weights) noexcept {
  return -weights.calm * (task.prismatic ? 1.0 : kHingeSpeedShare) * square(ds);
}

double r_press(double press_N, const RewardWeights& weights) noexcept {
  return -weights.press * std::max(press_N - weights.press_free_N, 0.0);
}

double r_load(std::span<const double> load, const RewardWeights& weights) noexcept {
  double sum = 0.0;
  for (const double share : load) sum += std::max(std::abs(share) - weights.load_free, 0.0);
  return -weights.load * sum;
}

double reward_of(const StepFacts& facts, const Task& task, const RewardWeights& weights) noexcept {
  return r_dist(facts.distance_m, facts.turn_rad, weights) + r_target(facts.s, task, weights) +
         r_contact(facts.s, facts.touches, facts.collides, task, weights) + r_reg(facts.dq, facts.ddq, weights) +
         r_success(facts.s, task, weights) + r_calm(facts.ds, task, weights) + r_press(facts.press_N, weights) +
         r_load(facts.load, weights);
}

}  // namespace s2r::planning
