// What rollouts are worth: from the records of the coarse model to a number each.
//
// Python's arrays would do, and did. But while rollouts run the processor's caches forget how numpy does things, so
// that some forty small operations between two batches cost several times their arithmetic, on one thread.
#pragma once

#include <span>
#include <vector>

#include "place.hpp"
#include "rewards.hpp"

namespace s2r::planning {

// Where the arm and the object's joint are in the records, and how the rollouts were made.
struct RolloutLayout {
  int dof = 0, s_qpos = 0, s_dof = 0;
  int substeps = 1;  // of a control step
  double control_dt_s = 0.0;
  std::vector<double> stiffness, damping;  // of the servos, over the joints' torque limits (dof)
  std::array<Vector3, 3> R_world_part{};   // rows; the part at s = 0
};

// One rollout, row by row. Sensors describe the state before their substep: tool pose in the part's frame (7), number
// of contacts of the robot (1), and per fingertip shape its contacts with the part (1) and their force (3), world
// frame.
struct Rollout {
  int steps = 0;  // control steps
  int nq = 0, nv = 0, nsensor = 0;
  const double *qpos = nullptr, *qvel = nullptr, *sensors = nullptr;  // (steps * substeps) rows each
  const double* targets = nullptr;                                    // joint targets [rad], (steps + 1) rows of dof
  const double* dq_start = nullptr;                                   // joint speeds at the start, (dof)
};

// Columns of the sensors.
constexpr int kOrientation = 3, kRobotContacts = 7, kFirstFinger = 8, kPerFinger = 4;

class Scorer {
 public:
  Scorer(const Place& place, RewardWeights weights, RolloutLayout layout);

  const RolloutLayout& layout() const noexcept { return layout_; }

  // What happened in a control step; the spans are good until the next call.
  StepFacts facts(const Rollout& rollout, int step) noexcept;

  // The mean of the reward over the steps.
  double value(const Rollout& rollout, const Task& task) noexcept;

 private:
  void read_sensors(const Rollout& rollout, int step, StepFacts& facts) const noexcept;

  Place place_;
  RewardWeights weights_;
  RolloutLayout layout_;
  std::vector<double> ddq_, load_;
};

}  // namespace s2r::planning
