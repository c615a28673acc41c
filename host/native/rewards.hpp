// The paper's reward, one function per term, each with the repair it needed.
//
// Paper: Ma et al., Sim2Real2: Actively Building Explicit Physics Model for Precise Articulated Object Manipulation,
// ICRA 2023, section "Sampling-based Model Predictive Control": the reward of a step is the sum of r_dist, r_target,
// r_contact, r_reg and r_success; a sequence is worth the mean over its steps.
// As printed, three of the five terms reward the wrong thing; each function says what was changed and why.
#pragma once

#include <span>
#include <vector>

namespace s2r::planning {

// What the reward compares with: start, goal and success band of the object's joint [m or rad], and its kind.
struct Task {
  double s_initial, s_target, tolerance;
  bool prismatic;
};

// Documented where they are set: s2r_host.planning.settings.RewardWeights.
struct RewardWeights {
  double distance, distance_width_m, turn_m, target, success, contact, contact_after, collision, speed, acceleration;
  double calm, press, press_free_N, load, load_free;
  std::vector<double> joints;  // one per joint of the arm
};

// What the reward needs to know about one step of a rollout.
struct StepFacts {
  double distance_m = 0.0;          // fingertip to its point on the part
  double turn_rad = 0.0;            // between the tool and its orientation at that point
  double s = 0.0, ds = 0.0;         // joint of the object [m or rad], its speed
  bool touches = false;             // the fingertip touches the part
  bool collides = false;            // the robot touches anything else
  double press_N = 0.0;             // force of the fingertip on the part across the part's motion
  std::span<const double> dq, ddq;  // joint speeds [rad/s] and accelerations [rad/s^2]
  std::span<const double> load;     // servo torques without gravity compensation over the joints' torque limits
};

// Distance term: -w (||p_tip - p_part||^2 + (l turn)^2).
// Repair: printed with a plus, which pays for going away. The second part is ours: behind a handle the orientation
// decides whether the hand fits, and the distance alone knows nothing of it; l = 0 is the paper's term. Beyond the
// width it grows linearly.
double r_dist(double distance_m, double turn_rad, const RewardWeights& weights) noexcept;

// Share of the way that remains, |s_target - s| / |s_target - s_initial|; 1 at the start, 0 on target.
double remaining(double s, const Task& task) noexcept;

// Approach term: -w times the remaining share. Repair: absolute value; the printed ratio pays for overshoot.
double r_target(double s, const Task& task, const RewardWeights& weights) noexcept;

// True within the success band. Repair: one band per joint type; the paper has 0.005 for m and rad alike.
bool on_target(double s, const Task& task) noexcept;

// Success term: +w within the band. A momentary pass does not end a plan: the hold in the fine model does.
double r_success(double s, const Task& task, const RewardWeights& weights) noexcept;

// Contact term: +w for touching the part with progress, -w for touching after success, -w for a collision.
// Repair: the printed condition for the bonus has progress but no contact, and several cases can hold at once; here the
// bonus needs both, progress means one success band nearer to the target, and a collision wins.
double r_contact(double s, bool touches, bool collides, const Task& task, const RewardWeights& weights) noexcept;

// Regularisation: -sum over the d joints of w_j (w_a |ddq_j| + w_v |dq_j|).
// Repair: absolute values (printed signed, so moving backwards is paid) and d joints instead of d + 1; the acceleration
// is the change of speed over a control step.
double r_reg(std::span<const double> dq, std::span<const double> ddq, const RewardWeights& weights) noexcept;

// Speed term of the object: -w ds^2. Not in the paper; the authors' code has -5 |ds|.
// A fast part coasts on when the fingertip stops, by an amount that depends on a friction nobody has measured. The
// square gives a speed that is worth having: a linear term is either too weak or stops all motion.
double r_calm(double ds, const Task& task, const RewardWeights& weights) noexcept;

// Press term: -w times the force across the part's motion beyond a free one. An addition to the paper.
// Such a force moves nothing. With little friction in the model the fingertip slides along an edge that it jams on in
// truth.
double r_press(double press_N, const RewardWeights& weights) noexcept;

// Load term: -w times each joint's servo torque beyond a free share of its limit. An addition to the paper.
// The rollout model does not saturate torques (with limits in it, a long time step makes the arm lag), so nothing else
// keeps a plan from pressing with more than the motors have, which the fine model then cannot follow.
double r_load(std::span<const double> load, const RewardWeights& weights) noexcept;

// The paper's five terms and the three added.
double reward_of(const StepFacts& facts, const Task& task, const RewardWeights& weights) noexcept;

}  // namespace s2r::planning
