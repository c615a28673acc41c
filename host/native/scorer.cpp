#include "scorer.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

namespace s2r::planning {

Scorer::Scorer(const Place& place, RewardWeights weights, RolloutLayout layout)
    : place_(place), weights_(std::move(weights)), layout_(std::move(layout)) {
  ddq_.resize(static_cast<std::size_t>(layout_.dof));
  load_.resize(static_cast<std::size_t>(layout_.dof));
}

StepFacts Scorer::facts(const Rollout& rollout, int step) noexcept {
  const auto dof = static_cast<std::size_t>(layout_.dof);
  const int end = (step + 1) * layout_.substeps - 1;  // the last substep's row
  const double* const q = rollout.qpos + end * rollout.nq;
  const double* const dq = rollout.qvel + end * rollout.nv;
  const double* const before = step == 0 ? rollout.dq_start : dq - layout_.substeps * rollout.nv;
  const double* const target = rollout.targets + (step + 1) * layout_.dof;
  for (std::size_t j = 0; j < dof; ++j) {
    ddq_[j] = (dq[j] - before[j]) / layout_.control_dt_s;
    load_[j] = layout_.stiffness[j] * (target[j] - q[j]) - layout_.damping[j] * dq[j];
  }
  StepFacts facts;
  facts.s = q[layout_.s_qpos];
  facts.ds = dq[layout_.s_dof];
  facts.dq = {dq, dof};
  facts.ddq = ddq_;
  facts.load = load_;
  read_sensors(rollout, step, facts);
  return facts;
}

void Scorer::read_sensors(const Rollout& rollout, int step, StepFacts& facts) const noexcept {
  // Of the state after a substep the next row tells; after the last one there is none, its own has to do.
  const int last = rollout.steps * layout_.substeps - 1;
  const auto row_after = [&](int substep) { return std::min(substep + 1, last); };
  const auto sensors = [&](int row) { return rollout.sensors + row * rollout.nsensor; };
  const auto joint = [&](int row) { return rollout.qpos[std::max(row - 1, 0) * rollout.nq + layout_.s_qpos]; };
  const int first = step * layout_.substeps, end = first + layout_.substeps - 1;
  double across_squared = 0.0;
  for (int substep = first; substep <= end; ++substep) {
    const double* const seen = sensors(row_after(substep));
    double contacts = 0.0;
    Vector3 force{};  // of all fingertip shapes together, world frame
    for (int k = kFirstFinger; k < rollout.nsensor; k += kPerFinger) {
      contacts += seen[k];
      for (int i = 0; i < 3; ++i) force[static_cast<std::size_t>(i)] += seen[k + 1 + i];
    }
    facts.touches |= contacts > 0.0;
    facts.collides |= seen[kRobotContacts] > contacts;
    if (contacts == 0.0) continue;
    const Vector3 push = place_.push(joint(row_after(substep)));
    const auto& R = layout_.R_world_part;
    const double along = dot(force, {dot(R[0], push), dot(R[1], push), dot(R[2], push)});
    across_squared = std::max(across_squared, dot(force, force) - along * along);
  }
  facts.press_N = std::sqrt(across_squared);
  const double* const tip = sensors(row_after(end));
  const double* const tool = tip + kOrientation;
  facts.distance_m = place_.distance({tip[0], tip[1], tip[2]});
  facts.turn_rad = place_.turn({tool[0], tool[1], tool[2], tool[3]}, joint(row_after(end)));
}

double Scorer::value(const Rollout& rollout, const Task& task) noexcept {
  double sum = 0.0;
  for (int step = 0; step < rollout.steps; ++step) sum += reward_of(facts(rollout, step), task, weights_);
  return sum / rollout.steps;
}

}  // namespace s2r::planning
