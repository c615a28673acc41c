// The planner's side for Python.
#include <nanobind/stl/array.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <string>
#include <utility>
#include <vector>

#include "arrays.hpp"
#include "gap_bindings.hpp"
#include "place.hpp"
#include "rewards.hpp"
#include "scorer.hpp"

namespace s2r::planning {

using namespace nb::literals;

namespace {

int size(std::size_t n) { return static_cast<int>(n); }

Result distances(const Place& place, const Doubles<2>& p_tip_part) {
  require(p_tip_part.shape(1) == 3, "p_tip_part must be (n, 3)");
  Numbers found(p_tip_part.shape(0));
  for (std::size_t i = 0; i < found.size(); ++i) {
    const double* const p = p_tip_part.data() + 3 * i;
    found[i] = place.distance({p[0], p[1], p[2]});
  }
  return to_array(std::move(found), {p_tip_part.shape(0)});
}

// The records of one call of rollouts, (rollout, row, number) each.
struct Records {
  Doubles<3> qpos, qvel, sensors, targets;
  Doubles<1> dq_start;

  int steps() const { return size(targets.shape(1)) - 1; }

  void check(const RolloutLayout& layout) const {
    const std::size_t rows = (targets.shape(1) - 1) * static_cast<std::size_t>(layout.substeps);
    for (const Doubles<3>* record : {&qpos, &qvel, &sensors})
      require(record->shape(0) == targets.shape(0) && record->shape(1) == rows && rows > 0,
              "records must have a row per substep of " + std::to_string(targets.shape(0)) + " rollouts of " +
                  std::to_string(steps()) + " steps");
    const auto dof = static_cast<std::size_t>(layout.dof);
    require(targets.shape(2) == dof && dq_start.shape(0) >= dof, "targets and dq_start must have a number per joint");
    require(size(qpos.shape(2)) > layout.s_qpos && size(qvel.shape(2)) > layout.s_dof && qpos.shape(2) >= dof &&
                qvel.shape(2) >= dof,
            "qpos and qvel must hold the arm and the object's joint");
    require(size(sensors.shape(2)) >= kFirstFinger && (size(sensors.shape(2)) - kFirstFinger) % kPerFinger == 0,
            "sensors must be the tool's pose, the robot's contacts and four numbers per fingertip shape");
  }

  Rollout at(std::size_t rollout) const {
    const auto row = [rollout](const Doubles<3>& record) {
      return record.data() + rollout * record.shape(1) * record.shape(2);
    };
    return {steps(),   size(qpos.shape(2)), size(qvel.shape(2)), size(sensors.shape(2)), row(qpos),
            row(qvel), row(sensors),        row(targets),        dq_start.data()};
  }
};

Result values(Scorer& scorer, const Doubles<3>& qpos, const Doubles<3>& qvel, const Doubles<3>& sensors,
              const Doubles<3>& targets, const Doubles<1>& dq_start, const Task& task) {
  const Records records{qpos, qvel, sensors, targets, dq_start};
  records.check(scorer.layout());
  Numbers found(targets.shape(0));
  for (std::size_t i = 0; i < found.size(); ++i) found[i] = scorer.value(records.at(i), task);
  return to_array(std::move(found), {targets.shape(0)});
}

nb::dict facts(Scorer& scorer, const Doubles<3>& qpos, const Doubles<3>& qvel, const Doubles<3>& sensors,
               const Doubles<3>& targets, const Doubles<1>& dq_start) {
  const Records records{qpos, qvel, sensors, targets, dq_start};
  records.check(scorer.layout());
  Numbers distance_m, turn_rad, s, ds, touches, collides, press_N, dq, ddq, load;
  for (std::size_t i = 0; i < targets.shape(0); ++i) {
    for (int k = 0; k < records.steps(); ++k) {
      const StepFacts step = scorer.facts(records.at(i), k);
      distance_m.push_back(step.distance_m);
      turn_rad.push_back(step.turn_rad);
      s.push_back(step.s);
      ds.push_back(step.ds);
      touches.push_back(step.touches);
      collides.push_back(step.collides);
      press_N.push_back(step.press_N);
      dq.insert(dq.end(), step.dq.begin(), step.dq.end());
      ddq.insert(ddq.end(), step.ddq.begin(), step.ddq.end());
      load.insert(load.end(), step.load.begin(), step.load.end());
    }
  }
  const std::vector<std::size_t> per_step{targets.shape(0), targets.shape(1) - 1};
  const std::vector<std::size_t> per_joint{per_step[0], per_step[1], targets.shape(2)};
  nb::dict found;
  found["distance_m"] = to_array(std::move(distance_m), per_step);
  found["turn_rad"] = to_array(std::move(turn_rad), per_step);
  found["s"] = to_array(std::move(s), per_step);
  found["ds"] = to_array(std::move(ds), per_step);
  found["touches"] = to_array(std::move(touches), per_step);
  found["collides"] = to_array(std::move(collides), per_step);
  found["press_N"] = to_array(std::move(press_N), per_step);
  found["dq"] = to_array(std::move(dq), per_joint);
  found["ddq"] = to_array(std::move(ddq), per_joint);
  found["load"] = to_array(std::move(load), per_joint);
  return found;
}

void bind_rewards(nb::module_& m) {
  nb::class_<Task>(m, "Task",
                   "What the reward compares with: start, goal and success band of the object's joint [m or rad], and "
                   "its kind.")
      .def(
          "__init__",
          [](Task* task, double s_initial, double s_target, double tolerance, bool prismatic) {
            new (task) Task{s_initial, s_target, tolerance, prismatic};
          },
          "s_initial"_a, "s_target"_a, "tolerance"_a, "prismatic"_a)
      .def_ro("s_initial", &Task::s_initial)
      .def_ro("s_target", &Task::s_target)
      .def_ro("tolerance", &Task::tolerance)
      .def_ro("prismatic", &Task::prismatic);

  nb::class_<RewardWeights>(m, "RewardWeights", "s2r_host.planning.settings.RewardWeights, as the native code has it.")
      .def(
          "__init__",
          [](RewardWeights* weights, double distance, double distance_width_m, double turn_m, double target,
             double success, double contact, double contact_after, double collision, double speed, double acceleration,
             double calm, double press, double press_free_N, double load, double load_free, Numbers joints) {
            new (weights) RewardWeights{
                distance, distance_width_m, turn_m, target, success,      contact, contact_after, collision,
                speed,    acceleration,     calm,   press,  press_free_N, load,    load_free,     std::move(joints)};
          },
          nb::kw_only(), "distance"_a, "distance_width_m"_a, "turn_m"_a, "target"_a, "success"_a, "contact"_a,
          "contact_after"_a, "collision"_a, "speed"_a, "acceleration"_a, "calm"_a, "press"_a, "press_free_N"_a,
          "load"_a, "load_free"_a, "joints"_a);

  m.def("r_dist", &r_dist, "distance_m"_a, "turn_rad"_a, "weights"_a, "Distance term.");
  m.def("remaining", &remaining, "s"_a, "task"_a, "Share of the way that remains.");
  m.def("r_target", &r_target, "s"_a, "task"_a, "weights"_a, "Approach term.");
  m.def("r_success", &r_success, "s"_a, "task"_a, "weights"_a, "Success term.");
  m.def("r_contact", &r_contact, "s"_a, "touches"_a, "collides"_a, "task"_a, "weights"_a, "Contact term.");
  m.def(
      "r_reg",
      [](const Numbers& dq, const Numbers& ddq, const RewardWeights& weights) {
        require(dq.size() == weights.joints.size() && ddq.size() == dq.size(),
                "dq and ddq must have a number per joint: " + std::to_string(weights.joints.size()));
        return r_reg(dq, ddq, weights);
      },
      "dq"_a, "ddq"_a, "weights"_a, "Regularisation.");
  m.def("r_calm", &r_calm, "ds"_a, "task"_a, "weights"_a, "Speed term of the object.");
  m.def("r_press", &r_press, "press_N"_a, "weights"_a, "Press term.");
  m.def(
      "r_load", [](const Numbers& load, const RewardWeights& weights) { return r_load(load, weights); }, "load"_a,
      "weights"_a, "Load term.");
}

void bind_place(nb::module_& m) {
  nb::class_<Place>(m, "Place", "A place for the fingertip, as rollouts are judged by; see s2r_host.planning.hook.")
      .def(
          "__init__",
          [](Place* place, const Vector3& p, double push_m, const std::array<Vector3, 4>& axes,
             const std::array<Vector3, 3>& push_along, const std::array<Quaternion, 2>& grips, double s_start,
             double follow, double funnel_m, double funnel_slope) {
            new (place) Place({p, push_m, axes, push_along, grips, s_start, follow, funnel_m, funnel_slope});
          },
          nb::kw_only(), "p"_a, "push_m"_a, "axes"_a, "push_along"_a, "grips"_a, "s_start"_a, "follow"_a, "funnel_m"_a,
          "funnel_slope"_a)
      .def("distances", &distances, "p_tip_part"_a, "Of tool tips in the part's frame (n, 3) [m], (n,).")
      .def("turn", &Place::turn, "tool_wxyz"_a, "s"_a,
           "Angle [rad] between an orientation in the part's frame and the one wanted with the joint at s.");
}

void bind_scorer(nb::module_& m) {
  nb::class_<Scorer>(m, "Scorer", "Judges rollouts of the coarse model, for one place of the fingertip.")
      .def(
          "__init__",
          [](Scorer* scorer, const Place& place, const RewardWeights& weights, int s_qpos, int s_dof, int substeps,
             double control_dt_s, Numbers stiffness, Numbers damping, const std::array<Vector3, 3>& R_world_part) {
            const std::size_t dof = weights.joints.size();
            require(dof > 0 && stiffness.size() == dof && damping.size() == dof,
                    "weights, stiffness and damping must have a number per joint");
            require(substeps >= 1 && control_dt_s > 0.0 && s_qpos >= 0 && s_dof >= 0,
                    "substeps, control_dt_s, s_qpos and s_dof must be positive");
            new (scorer) Scorer(place, weights,
                                {size(dof), s_qpos, s_dof, substeps, control_dt_s, std::move(stiffness),
                                 std::move(damping), R_world_part});
          },
          nb::kw_only(), "place"_a, "weights"_a, "s_qpos"_a, "s_dof"_a, "substeps"_a, "control_dt_s"_a, "stiffness"_a,
          "damping"_a, "R_world_part"_a)
      .def("values", &values, "qpos"_a, "qvel"_a, "sensors"_a, "targets"_a, "dq_start"_a, "task"_a,
           "Mean reward of every rollout, (rollout,), from records (rollout, row, number) with a row per substep,\n"
           "joint targets (rollout, step + 1, dof) and the joint speeds at the start (at least dof).")
      .def("facts", &facts, "qpos"_a, "qvel"_a, "sensors"_a, "targets"_a, "dq_start"_a,
           "What the reward is made of, by name, (rollout, step) or (rollout, step, dof).");
}

}  // namespace
}  // namespace s2r::planning

NB_MODULE(_native, m) {
  m.doc() = "What is slow in Python: rewards of rollouts, and motors with a link behind a spring or play.";
  s2r::planning::bind_rewards(m);
  s2r::planning::bind_place(m);
  s2r::planning::bind_scorer(m);
  s2r::gap::bind_gap(m);
}
