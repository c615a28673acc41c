// The only unit that knows Python: the front end's side of the shared memory, the core stepped without sockets, and
// the pure units for tests.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/unique_ptr.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <deque>
#include <memory>
#include <optional>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include "clock.hpp"
#include "config.hpp"
#include "core.hpp"
#include "gate.hpp"
#include "joint_stop.hpp"
#include "packing.hpp"
#include "plan_check.hpp"
#include "shm.hpp"
#include "spline.hpp"
#include "state_machine.hpp"
#include "stop_search.hpp"
#include "time_scaling.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace s2r {
namespace {

using Vector = nb::ndarray<const double, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Matrix = nb::ndarray<const double, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using Array = nb::ndarray<nb::numpy, double>;

// --- arrays -------------------------------------------------------------------------------------------------------

// A fresh numpy array, to be filled through the pointer.
std::pair<Array, double*> make_array(std::vector<std::size_t> shape) {
  std::size_t size = 1;
  for (const std::size_t n : shape) size *= n;
  auto* data = new double[std::max<std::size_t>(size, 1)]();
  const nb::capsule owner(data, [](void* p) noexcept { delete[] static_cast<double*>(p); });
  return {Array(data, shape.size(), shape.data(), owner), data};
}

Array to_array(const Joints& values, int dof) {
  auto [array, data] = make_array({static_cast<std::size_t>(dof)});
  std::copy_n(values.begin(), dof, data);
  return array;
}

template <class T>
nb::object to_int_array(const PerJoint<T>& values, int dof) {
  nb::list items;
  for (int joint = 0; joint < dof; ++joint) items.append(static_cast<int>(values[joint]));
  return nb::module_::import_("numpy").attr("array")(items, "dtype"_a = "int64");
}

int check_dof(std::size_t columns, const char* what) {
  if (columns < 1 || columns > static_cast<std::size_t>(kMaxJoints))
    throw nb::value_error(
        (std::string(what) + " has " + std::to_string(columns) + " joints, allowed 1.." + std::to_string(kMaxJoints))
            .c_str());
  return static_cast<int>(columns);
}

Joints to_joints(const Vector& values, int dof, const char* what) {
  if (values.shape(0) != static_cast<std::size_t>(dof))
    throw nb::value_error(
        (std::string(what) + " has " + std::to_string(values.shape(0)) + " values, expected " + std::to_string(dof))
            .c_str());
  Joints out{};
  std::copy_n(values.data(), dof, out.begin());
  return out;
}

Joints row(const Matrix& values, std::size_t i) {
  Joints out{};
  std::copy_n(values.data() + i * values.shape(1), values.shape(1), out.begin());
  return out;
}

// A row of a (time, dof) result.
void put_row(double* data, std::size_t i, const Joints& values, int dof) {
  std::copy_n(values.begin(), dof, data + i * static_cast<std::size_t>(dof));
}

// --- configuration ------------------------------------------------------------------------------------------------

// Reads the fields of a dict by name; what was not asked for is an unknown field.
class Fields {
 public:
  explicit Fields(nb::dict values) : values_(std::move(values)) {}

  template <class T>
  void read(const char* name, T& out, bool required = false) {
    known_.emplace_back(name);
    if (!values_.contains(name)) {
      if (required) throw nb::value_error(("config: field '" + std::string(name) + "' is missing").c_str());
      return;
    }
    if (!nb::try_cast(values_[name], out)) fail(name);
  }

  void read(const char* name, Joints& out, int dof) {
    std::vector<double> values;
    read(name, values, true);
    if (values.size() != static_cast<std::size_t>(dof))
      throw nb::value_error(("config: '" + std::string(name) + "' has " + std::to_string(values.size()) +
                             " values, expected dof = " + std::to_string(dof))
                                .c_str());
    std::copy(values.begin(), values.end(), out.begin());
  }

  // One of two words.
  template <class Enum>
  void read(const char* name, Enum& out, std::pair<const char*, Enum> a, std::pair<const char*, Enum> b) {
    std::string word;
    read(name, word, true);
    if (word != a.first && word != b.first)
      throw nb::value_error(
          ("config: " + std::string(name) + " = '" + word + "': expected '" + a.first + "' or '" + b.first + "'")
              .c_str());
    out = word == a.first ? a.second : b.second;
  }

  void refuse_unknown() const {
    for (const auto& item : values_) {
      const auto name = nb::cast<std::string>(nb::str(item.first));
      if (std::find(known_.begin(), known_.end(), name) == known_.end())
        throw nb::value_error(("config: unknown field '" + name + "'").c_str());
    }
  }

 private:
  [[noreturn]] void fail(const char* name) const {
    const auto text = nb::cast<std::string>(nb::repr(values_[name]));
    throw nb::value_error(("config: " + std::string(name) + " = " + text + " has the wrong type").c_str());
  }

  nb::dict values_;
  std::vector<std::string> known_;
};

Config to_config(const nb::dict& values) {
  Fields fields(values);
  Config c;
  fields.read("dof", c.dof, true);
  if (c.dof < 1 || c.dof > kMaxJoints)
    throw nb::value_error(("config: dof = " + std::to_string(c.dof) + " is outside [1, 7]").c_str());
  fields.read("tick_ns", c.tick_ns, true);
  fields.read<PackingKind>("packing", c.packing, {"fd", PackingKind::kFd}, {"classic", PackingKind::kClassic});
  fields.read<ClockKind>("clock", c.clock, {"real", ClockKind::kReal}, {"lockstep", ClockKind::kLockstep});
  std::string bus;
  fields.read("bus", bus, true);
  if (bus.size() >= c.bus.size()) throw nb::value_error(("config: bus = '" + bus + "' is too long").c_str());
  std::copy(bus.begin(), bus.end(), c.bus.begin());
  fields.read("q_min", c.limits.q_min, c.dof);
  fields.read("q_max", c.limits.q_max, c.dof);
  fields.read("dq_max", c.limits.dq_max, c.dof);
  fields.read("ddq_max", c.limits.ddq_max, c.dof);
  fields.read("dddq_max", c.limits.dddq_max, c.dof);
  fields.read("tau_max", c.limits.tau_max, c.dof);
  fields.read("pace", c.pace);
  fields.read("gate_margin", c.gate_margin);
  fields.read("path_tolerance_rad", c.path_tolerance_rad);
  fields.read("goal_tolerance_rad", c.goal_tolerance_rad);
  fields.read("goal_timeout_s", c.goal_timeout_s);
  fields.read("feedback_warn_ticks", c.feedback_warn_ticks);
  fields.read("feedback_stop_ticks", c.feedback_stop_ticks);
  fields.read("feedback_fault_ticks", c.feedback_fault_ticks);
  fields.read("front_end_timeout_s", c.front_end_timeout_s);
  fields.read("answer_timeout_s", c.answer_timeout_s);
  fields.read("arming_timeout_s", c.arming_timeout_s);
  fields.read("quit_timeout_s", c.quit_timeout_s);
  fields.read("realtime_priority", c.realtime_priority);
  fields.read("cpu", c.cpu);
  fields.read("allow_not_realtime", c.allow_not_realtime);
  fields.read("record_capacity", c.record_capacity);
  fields.read("drive_extrapolation_ticks", c.drive_extrapolation_ticks);
  fields.read("overrun_stop_count", c.overrun_stop_count);
  fields.read("following_rest_share", c.following_rest_share);
  fields.read("frozen_rad", c.frozen_rad);
  fields.read("collision_share", c.collision_share);
  fields.read("collision_ticks", c.collision_ticks);
  fields.read("temperature_warn_C", c.temperature_warn_C);
  fields.read("temperature_stop_C", c.temperature_stop_C);
  fields.read("warning_speed", c.warning_speed);
  fields.read("brake_feedback", c.brake_feedback);
  fields.read("brake_timeout_s", c.brake_timeout_s);
  fields.read("estop_discrepancy_s", c.estop_discrepancy_s);
  fields.refuse_unknown();
  if (const std::string fault = find_fault(c); !fault.empty()) throw nb::value_error(("config: " + fault).c_str());
  return c;
}

// --- structured arrays --------------------------------------------------------------------------------------------

struct Field {
  const char* name;
  const char* format;
  std::size_t offset;
  bool per_joint = false;
};

const std::vector<Field>& record_fields() {
  static const std::vector<Field> fields{
      {"tick", "<u8", offsetof(Record, tick)},
      {"stamp_ns", "<i8", offsetof(Record, stamp_ns)},
      {"lateness_ns", "<i8", offsetof(Record, lateness_ns)},
      {"state", "u1", offsetof(Record, state)},
      {"cause", "<u2", offsetof(Record, cause)},
      {"plan_id", "<u8", offsetof(Record, plan_id)},
      {"plan_t", "<f8", offsetof(Record, plan_t)},
      {"speed_scale", "<f8", offsetof(Record, speed_scale)},
      {"q_ref", "<f8", offsetof(Record, q_ref), true},
      {"dq_ref", "<f8", offsetof(Record, dq_ref), true},
      {"ddq_ref", "<f8", offsetof(Record, ddq_ref), true},
      {"q_meas", "<f8", offsetof(Record, q_meas), true},
      {"dq_meas", "<f8", offsetof(Record, dq_meas), true},
      {"tau_meas", "<f8", offsetof(Record, tau_meas), true},
  };
  return fields;
}

const std::vector<Field>& event_fields() {
  static const std::vector<Field> fields{
      {"tick", "<u8", offsetof(Event, tick)},       {"stamp_ns", "<i8", offsetof(Event, stamp_ns)},
      {"kind", "<u2", offsetof(Event, kind)},       {"state", "u1", offsetof(Event, state)},
      {"cause", "<u2", offsetof(Event, cause)},     {"joint", "<i2", offsetof(Event, joint)},
      {"plan_id", "<u8", offsetof(Event, plan_id)}, {"value", "<f8", offsetof(Event, value)},
      {"limit", "<f8", offsetof(Event, limit)},
  };
  return fields;
}

// Fields in the order of their offsets: numpy writes no other dtype to a file.
nb::object make_dtype(std::vector<Field> fields, std::size_t item_size, int dof) {
  std::sort(fields.begin(), fields.end(), [](const Field& a, const Field& b) { return a.offset < b.offset; });
  nb::list names, formats, offsets;
  for (const Field& field : fields) {
    names.append(field.name);
    if (field.per_joint)
      formats.append(nb::make_tuple(field.format, nb::make_tuple(dof)));
    else
      formats.append(field.format);
    offsets.append(field.offset);
  }
  nb::dict spec;
  spec["names"] = names;
  spec["formats"] = formats;
  spec["offsets"] = offsets;
  spec["itemsize"] = item_size;
  return nb::module_::import_("numpy").attr("dtype")(spec);
}

// Empties a ring into a structured array of at most max_items.
template <class T>
nb::object drain(Ring<T> ring, std::size_t max_items, const nb::object& dtype) {
  const std::size_t n = std::min<std::size_t>(ring.size(), max_items);
  nb::object array = nb::module_::import_("numpy").attr("empty")(n, "dtype"_a = dtype);
  // numpy hands out the address of a structured array only as a number. NOLINTNEXTLINE(performance-no-int-to-ptr)
  auto* bytes = reinterpret_cast<char*>(nb::cast<std::uintptr_t>(array.attr("ctypes").attr("data")));
  T item;
  for (std::size_t i = 0; i < n && ring.pop(item); ++i) std::memcpy(bytes + i * sizeof(T), &item, sizeof(T));
  return array;
}

// --- Shared -------------------------------------------------------------------------------------------------------

struct PySnapshot {
  Snapshot s{};
  bool alive = false;
  int cpu = -1;
  int dof = 0;
};

class PyShared {
 public:
  explicit PyShared(const Config& config)
      : memory_(SharedMemory::create(config)),
        record_dtype_(make_dtype(record_fields(), sizeof(Record), config.dof)),
        event_dtype_(make_dtype(event_fields(), sizeof(Event), config.dof)) {
    memory_.release();
  }

  SharedBlock& block() const noexcept { return memory_.block(); }
  int fd() const noexcept { return memory_.fd(); }
  void beat() noexcept { block().beats.fetch_add(1, std::memory_order_relaxed); }

  bool submit_plan(std::uint64_t plan_id, std::uint64_t epoch, const Vector& t, const Matrix& q, const Matrix& dq,
                   const Matrix& ddq, const Vector& stop_duration, double path_tolerance, double goal_tolerance,
                   std::uint64_t parent_id, double splice_t, const std::optional<Matrix>& tau_rest,
                   const std::optional<Matrix>& tau_move) {
    const std::size_t n = t.shape(0);
    const auto dof = static_cast<std::size_t>(block().config.dof);
    if (n < 2 || n > static_cast<std::size_t>(kMaxKnots))
      throw nb::value_error(
          ("plan has " + std::to_string(n) + " knots, allowed 2.." + std::to_string(kMaxKnots)).c_str());
    for (const auto& [name, matrix] : {std::pair{"q", &q}, std::pair{"dq", &dq}, std::pair{"ddq", &ddq}})
      if (matrix->shape(0) != n || matrix->shape(1) != dof)
        throw nb::value_error(("plan: " + std::string(name) + " has shape (" + std::to_string(matrix->shape(0)) + ", " +
                               std::to_string(matrix->shape(1)) + "), expected (" + std::to_string(n) + ", " +
                               std::to_string(dof) + ")")
                                  .c_str());
    if (stop_duration.shape(0) != n - 1)
      throw nb::value_error(("plan: stop_duration has " + std::to_string(stop_duration.shape(0)) +
                             " values, expected one per segment, " + std::to_string(n - 1))
                                .c_str());
    if (tau_rest.has_value() != tau_move.has_value())
      throw nb::value_error("plan: tau_rest and tau_move come together or not at all");
    for (const auto& [name, matrix] : {std::pair{"tau_rest", &tau_rest}, std::pair{"tau_move", &tau_move}})
      if (matrix->has_value() && ((*matrix)->shape(0) != n || (*matrix)->shape(1) != dof))
        throw nb::value_error(("plan: " + std::string(name) + " is not of shape (knots, joints)").c_str());
    for (PlanSlot& slot : block().plans) {
      if (slot.filled.load(std::memory_order_acquire) != 0) continue;
      Plan& plan = slot.plan;
      plan.id = plan_id;
      plan.epoch = epoch;
      plan.parent_id = parent_id;
      plan.splice_t = splice_t;
      plan.path_tolerance = path_tolerance;
      plan.goal_tolerance = goal_tolerance;
      plan.knots = static_cast<int>(n);
      plan.dof = static_cast<int>(dof);
      std::copy_n(t.data(), n, plan.t.begin());
      std::copy_n(stop_duration.data(), n - 1, plan.stop_duration.begin());
      for (std::size_t i = 0; i < n; ++i) {
        plan.q[i] = row(q, i);
        plan.dq[i] = row(dq, i);
        plan.ddq[i] = row(ddq, i);
        if (tau_rest) plan.tau_rest[i] = row(*tau_rest, i);
        if (tau_move) plan.tau_move[i] = row(*tau_move, i);
      }
      plan.has_torque = tau_rest.has_value();
      slot.order = block().plans_submitted.fetch_add(1, std::memory_order_relaxed) + 1;
      slot.filled.store(1, std::memory_order_release);
      return true;
    }
    return false;
  }

  bool command(std::uint32_t kind, std::uint64_t epoch, double value) {
    return block().commands().push(
        {.kind = static_cast<CommandKind>(kind), .reserved = 0, .epoch = epoch, .value = value});
  }

  // The core counts up while it lives; whoever asks rarely sees a change, whoever asks often needs patience.
  PySnapshot snapshot() {
    PySnapshot out;
    out.dof = block().config.dof;
    // A core that was killed, or lost the processor, in the middle of its write leaves one that nobody finishes: the
    // newest whole copy stands then, and the beats below tell whether the core still lives.
    for (int i = 0; i < kSnapshotTries && !block().snapshot.try_read(snapshot_); ++i) {
    }
    out.s = snapshot_;
    const std::uint64_t beats = block().core_beats.load(std::memory_order_relaxed);
    const std::int64_t now = monotonic_ns();
    if (beats != core_beats_) {
      core_beats_ = beats;
      core_seen_ns_ = now;
    }
    out.cpu = block().pinned_cpu.load(std::memory_order_relaxed);
    const bool stepped = block().config.clock == ClockKind::kLockstep;
    out.alive = block().core_running.load(std::memory_order_acquire) != 0 &&
                now - core_seen_ns_ < (stepped ? kSteppedAliveTimeout_ns : kAliveTimeout_ns);
    return out;
  }

  nb::object records(std::size_t max_records) { return drain(block().records(), max_records, record_dtype_); }
  nb::object events(std::size_t max_events) { return drain(block().events(), max_events, event_dtype_); }

 private:
  static constexpr std::int64_t kAliveTimeout_ns = 1'000'000'000;
  static constexpr std::int64_t kSteppedAliveTimeout_ns = 10'000'000'000;  // it waits for the stand-in, however slow
  static constexpr int kSnapshotTries = 1000;  // a write takes less time than one try to read
  SharedMemory memory_;
  nb::object record_dtype_, event_dtype_;
  Snapshot snapshot_{};
  std::uint64_t core_beats_ = 0;
  std::int64_t core_seen_ns_ = 0;
};

// --- Core stepped from Python ---------------------------------------------------------------------------------------

using PyFrame = std::tuple<std::uint32_t, nb::bytes, bool>;  // identifier, data, is FD

PyFrame to_python(const Frame& frame) { return {frame.id, nb::bytes(frame.data.data(), frame.length), frame.fd}; }

Frame to_frame(std::uint32_t id, const nb::bytes& data, bool fd) {
  Frame frame;
  if (data.size() > (fd ? 64U : 8U)) throw nb::value_error("frame: too many data bytes");
  frame.error = (id & 0x2000'0000U) != 0U;  // CAN_ERR_FLAG
  frame.id = id & (frame.error ? 0x1FFF'FFFFU : 0x7FFU);
  frame.fd = fd;
  frame.length = static_cast<std::uint8_t>(data.size());
  std::memcpy(frame.data.data(), data.c_str(), data.size());
  return frame;
}

class QueuePort final : public FramePort {
 public:
  Rx receive(Frame& frame) noexcept override {
    if (in_.empty()) return closed ? Rx::kClosed : Rx::kEmpty;
    frame = in_.front();
    in_.pop_front();
    return Rx::kFrame;
  }
  int send(std::span<const Frame> frames) noexcept override {
    if (send_fails) return 0;
    out.insert(out.end(), frames.begin(), frames.end());
    return static_cast<int>(frames.size());
  }
  void put(const Frame& frame) { in_.push_back(frame); }

  std::vector<Frame> out;
  bool send_fails = false;
  bool closed = false;

 private:
  std::deque<Frame> in_;
};

class PyCore {
 public:
  PyCore(PyShared& shared, std::uint64_t first_tick)
      : core_(std::make_unique<Core>(shared.block(), port_, false, first_tick)) {}

  std::vector<PyFrame> step(const std::vector<PyFrame>& frames, std::int64_t now_ns, std::uint64_t skipped,
                            bool send_fails) {
    port_.out.clear();
    port_.send_fails = send_fails;
    for (const auto& [id, data, fd] : frames) port_.put(to_frame(id, data, fd));
    if (skipped > 0) core_->skip(skipped, now_ns);
    core_->tick(now_ns, 0);
    std::vector<PyFrame> out;
    out.reserve(port_.out.size());
    for (const Frame& frame : port_.out) out.push_back(to_python(frame));
    return out;
  }

  void request_quit() { core_->request_quit(); }
  void close_bus() { port_.closed = true; }
  bool all_answered() const { return core_->all_answered(); }
  bool finished() const { return core_->finished(); }

 private:
  QueuePort port_;
  std::unique_ptr<Core> core_;
};

// --- pure units -----------------------------------------------------------------------------------------------------

std::unique_ptr<Plan> make_plan(const Vector& t, const Matrix& q, const Matrix& dq, const Matrix& ddq) {
  auto plan = std::make_unique<Plan>();
  plan->knots = static_cast<int>(t.shape(0));
  plan->dof = check_dof(q.shape(1), "q");
  if (plan->knots < 2 || plan->knots > kMaxKnots || q.shape(0) != t.shape(0) || dq.shape(0) != t.shape(0) ||
      ddq.shape(0) != t.shape(0) || dq.shape(1) != q.shape(1) || ddq.shape(1) != q.shape(1))
    throw nb::value_error("spline: t (n,), q, dq, ddq (n, dof) with 2 <= n <= 4096");
  std::copy_n(t.data(), t.shape(0), plan->t.begin());
  for (std::size_t i = 0; i < t.shape(0); ++i) {
    plan->q[i] = row(q, i);
    plan->dq[i] = row(dq, i);
    plan->ddq[i] = row(ddq, i);
  }
  return plan;
}

nb::tuple evaluate_spline(const Vector& t, const Matrix& q, const Matrix& dq, const Matrix& ddq, const Vector& s) {
  const auto plan = make_plan(t, q, dq, ddq);
  PlanCursor cursor;
  cursor.open(*plan);
  const std::vector<std::size_t> shape{s.shape(0), q.shape(1)};
  auto [p, p_data] = make_array(shape);
  auto [v, v_data] = make_array(shape);
  auto [a, a_data] = make_array(shape);
  auto [j, j_data] = make_array(shape);
  for (std::size_t i = 0; i < s.shape(0); ++i) {
    const PathPoint point = cursor.at(s.data()[i]);
    put_row(p_data, i, point.q, plan->dof);
    put_row(v_data, i, point.dq, plan->dof);
    put_row(a_data, i, point.ddq, plan->dof);
    put_row(j_data, i, point.dddq, plan->dof);
  }
  return nb::make_tuple(p, v, a, j);
}

nb::tuple rate_ramp(double start, const std::vector<std::tuple<int, double, double>>& changes, double dt, int ticks) {
  RateRamp ramp;
  ramp.reset(start);
  const std::vector<std::size_t> shape{static_cast<std::size_t>(ticks)};
  auto [rate, rate_data] = make_array(shape);
  auto [rate_dot, rate_dot_data] = make_array(shape);
  auto [distance, distance_data] = make_array(shape);
  double sum = 0.0;
  for (int i = 0; i < ticks; ++i) {
    for (const auto& [tick, target, duration] : changes)
      if (tick == i) ramp.change(target, duration);
    const RateRamp::Step step = ramp.advance(dt);
    sum += step.distance;
    rate_data[i] = step.rate;
    rate_dot_data[i] = step.rate_dot;
    distance_data[i] = sum;
  }
  return nb::make_tuple(rate, rate_dot, distance);
}

nb::tuple joint_stop(const Vector& q, const Vector& dq, const Vector& ddq, const Vector& ddq_max,
                     const Vector& dddq_max, const Vector& times) {
  const int dof = check_dof(q.shape(0), "q");
  Limits limits;
  limits.ddq_max = to_joints(ddq_max, dof, "ddq_max");
  limits.dddq_max = to_joints(dddq_max, dof, "dddq_max");
  JointStop stop;
  stop.begin({to_joints(q, dof, "q"), to_joints(dq, dof, "dq"), to_joints(ddq, dof, "ddq")}, limits, dof);
  Joints durations;
  for (int joint = 0; joint < dof; ++joint) durations[joint] = stop.duration(joint);
  const std::vector<std::size_t> shape{times.shape(0), q.shape(0)};
  auto [p, p_data] = make_array(shape);
  auto [v, v_data] = make_array(shape);
  auto [a, a_data] = make_array(shape);
  for (std::size_t i = 0; i < times.shape(0); ++i) {
    const Reference at = stop.at(times.data()[i]);
    put_row(p_data, i, at.q, dof);
    put_row(v_data, i, at.dq, dof);
    put_row(a_data, i, at.ddq, dof);
  }
  return nb::make_tuple(to_array(durations, dof), p, v, a);
}

// Power-basis coefficients of all segments, shape (segments, 6, dof), in time since the segment's knot.
using Coefficients = nb::ndarray<const double, nb::shape<-1, 6, -1>, nb::c_contig, nb::device::cpu>;

nb::tuple sample_polynomials(const Vector& knots, const Coefficients& coefficients, const Vector& times) {
  const std::size_t segments = coefficients.shape(0), dof = coefficients.shape(2), count = times.shape(0);
  if (segments == 0 || knots.shape(0) != segments + 1) throw nb::value_error("polynomials: knots do not fit segments");
  const std::vector<std::size_t> shape{count, dof};
  auto [p, p_data] = make_array(shape);
  auto [v, v_data] = make_array(shape);
  auto [a, a_data] = make_array(shape);
  auto [j, j_data] = make_array(shape);
  const double* const first = knots.data();
  for (std::size_t i = 0; i < count; ++i) {
    const double t = times.data()[i];
    const auto after = std::upper_bound(first + 1, first + segments, t);  // the last segment holds the end
    const auto segment = static_cast<std::size_t>(after - first) - 1;
    const double x = t - first[segment];
    const double* c = coefficients.data() + segment * 6 * dof;
    for (std::size_t k = 0; k < dof; ++k) {
      const double c1 = c[dof + k], c2 = c[2 * dof + k], c3 = c[3 * dof + k], c4 = c[4 * dof + k], c5 = c[5 * dof + k];
      const std::size_t at = i * dof + k;
      // The analyser does not follow a vector's elements into the product that is the array's size.
      // NOLINTNEXTLINE(clang-analyzer-security.ArrayBound)
      p_data[at] = c[k] + x * (c1 + x * (c2 + x * (c3 + x * (c4 + x * c5))));
      v_data[at] = c1 + x * (2 * c2 + x * (3 * c3 + x * (4 * c4 + x * 5 * c5)));
      a_data[at] = 2 * c2 + x * (6 * c3 + x * (12 * c4 + x * 20 * c5));
      j_data[at] = 6 * c3 + x * (24 * c4 + x * 60 * c5);
    }
  }
  return nb::make_tuple(p, v, a, j);
}

using BlendsFound = std::tuple<std::vector<double>, int, std::tuple<Array, Array, Array>>;

BlendsFound shortest_blends(const Vector& knots, const Coefficients& coefficients,
                            const std::tuple<Matrix, Matrix, Matrix>& load, double load_step_s, double cell_s,
                            const std::vector<double>& durations, const Vector& ddq_limit, const Vector& dddq_limit,
                            const Vector& tau_limit) {
  const auto& [rest, move, inertia] = load;
  const int dof = check_dof(coefficients.shape(2), "coefficients");
  if (coefficients.shape(0) == 0 || knots.shape(0) != coefficients.shape(0) + 1)
    throw nb::value_error("blends: knots do not fit segments");
  for (const Matrix* m : {&rest, &move, &inertia})
    if (m->shape(0) != rest.shape(0) || m->shape(1) != coefficients.shape(2))
      throw nb::value_error("load: shapes differ");
  if (durations.empty() || !std::ranges::is_sorted(durations) || !(durations.front() > 0.0))
    throw nb::value_error("blends: durations must be positive and rise");
  if (!(load_step_s > 0.0 && cell_s > 0.0)) throw nb::value_error("blends: steps must be positive");
  const Polynomials plan{.dof = dof,
                         .segments = static_cast<int>(coefficients.shape(0)),
                         .knots = knots.data(),
                         .coefficients = coefficients.data()};
  const LoadGrid grid{.points = static_cast<int>(rest.shape(0)),
                      .step_s = load_step_s,
                      .rest = rest.data(),
                      .path = move.data(),
                      .inertia = inertia.data()};
  const BlendLimits limits{.ddq = to_joints(ddq_limit, dof, "ddq_limit"),
                           .dddq = to_joints(dddq_limit, dof, "dddq_limit"),
                           .tau = to_joints(tau_limit, dof, "tau_limit")};
  Blends found;
  {
    // A long plan takes a tenth of a second: beats and heartbeats must come through meanwhile. The caller keeps the
    // arrays.
    const nb::gil_scoped_release others_may_run;
    found = find_blends(plan, grid, durations, limits, cell_s);
  }
  return {found.durations,
          found.none.segment,
          {to_array(found.none.ddq, dof), to_array(found.none.dddq, dof), to_array(found.none.tau, dof)}};
}

using GateVerdict = std::tuple<std::size_t, int, int, double, double>;  // index, cause, joint, value, limit

std::optional<GateVerdict> gate_check(const Matrix& q, const Matrix& dq, double dt, const nb::dict& limits,
                                      double margin) {
  const int dof = check_dof(q.shape(1), "q");
  if (dq.shape(0) != q.shape(0) || dq.shape(1) != q.shape(1)) throw nb::value_error("gate: q and dq differ in shape");
  Fields fields(limits);
  Limits bounds;
  fields.read("q_min", bounds.q_min, dof);
  fields.read("q_max", bounds.q_max, dof);
  fields.read("dq_max", bounds.dq_max, dof);
  fields.read("ddq_max", bounds.ddq_max, dof);
  fields.read("dddq_max", bounds.dddq_max, dof);
  fields.refuse_unknown();
  Gate gate;
  gate.configure(bounds, dof, dt, margin);
  for (std::size_t i = 0; i < q.shape(0); ++i) {
    const Joints q_row = row(q, i), dq_row = row(dq, i);
    EncodedSetpoint setpoint;
    for (int joint = 0; joint < dof; ++joint) setpoint[joint] = encode_joint(q_row[joint], dq_row[joint]);
    if (i == 0) gate.reset(setpoint);
    if (const Trip trip = gate.check(setpoint))
      return GateVerdict{i, static_cast<int>(trip.cause), trip.joint, trip.value, trip.limit};
    gate.commit(setpoint);
  }
  return std::nullopt;
}

PackingKind to_packing(const std::string& name) {
  if (name != "fd" && name != "classic")
    throw nb::value_error(("packing = '" + name + "': expected 'fd' or 'classic'").c_str());
  return name == "fd" ? PackingKind::kFd : PackingKind::kClassic;
}

// A drive link of its own, to look at its bytes.
class PyPacking {
 public:
  PyPacking(const std::string& packing, int dof, double dt)
      : dof_(check_dof(static_cast<std::size_t>(dof), "packing")) {
    fd_.configure(dof);
    classic_.configure(dof, dt);
    if (to_packing(packing) == PackingKind::kFd)
      packing_ = &fd_;
    else
      packing_ = &classic_;
  }
  PyPacking(const PyPacking&) = delete;
  PyPacking& operator=(const PyPacking&) = delete;

  std::vector<PyFrame> encode(std::uint64_t tick, std::uint8_t seq, int request, const Vector& q, const Vector& dq) {
    const Joints q_row = to_joints(q, dof_, "q"), dq_row = to_joints(dq, dof_, "dq");
    sent_ = {.tick = tick, .seq = seq, .request = static_cast<DriveRequest>(request), .setpoint = {}};
    for (int joint = 0; joint < dof_; ++joint) {
      sent_.setpoint[joint] = encode_joint(q_row[joint], dq_row[joint]);
      if (!sent_.setpoint[joint].ok)
        throw nb::value_error(("joint " + std::to_string(joint) + ": q = " + std::to_string(q_row[joint]) +
                               ", dq = " + std::to_string(dq_row[joint]) + " cannot be encoded")
                                  .c_str());
    }
    std::array<Frame, kMaxFramesPerTick> frames{};
    const int n = packing_->pack(sent_, drives_, frames);
    packing_->sent();
    std::vector<PyFrame> out;
    out.reserve(static_cast<std::size_t>(n));
    for (std::size_t i = 0; i < static_cast<std::size_t>(n); ++i) out.push_back(to_python(frames[i]));
    return out;
  }

  std::pair<int, int> decode(std::uint32_t id, const nb::bytes& data, bool fd) {
    const RxResult result = packing_->unpack(to_frame(id, data, fd), sent_, drives_);
    return {static_cast<int>(result.kind), result.joint};
  }

  nb::dict drive(int joint) const {
    if (joint < 0 || joint >= dof_) throw nb::index_error("no such joint");
    const JointFeedback& d = drives_[joint];
    nb::dict out;
    out["q"] = d.q;
    out["dq"] = d.dq;
    out["tau"] = d.tau;
    out["state"] = static_cast<int>(d.state);
    out["brake_released"] = d.brake_released;
    out["following_warning"] = d.following_warning;
    out["error"] = d.error;
    out["temperature_C"] = static_cast<int>(d.temperature_C);
    out["seen"] = d.seen;
    out["answered_tick"] = d.answered_tick;
    return out;
  }

  bool tx_allowed(std::uint32_t id, int length, bool fd) const { return packing_->tx_allowed(id, length, fd); }

 private:
  int dof_;
  PackingFd fd_{};
  PackingClassic classic_{};
  Packing* packing_ = nullptr;
  DriveCommand sent_{};
  PerJoint<JointFeedback> drives_{};
};

template <class Table>
nb::dict to_dict(const Table& table) {
  nb::dict out;
  for (const auto& row : table) out[nb::str(row.name.data(), row.name.size())] = static_cast<int>(row.value);
  return out;
}

nb::dict cause_table(bool categories) {
  nb::dict out;
  for (const CauseRow& row : kCauses)
    out[nb::str(row.name.data(), row.name.size())] =
        categories ? static_cast<int>(row.category) : static_cast<int>(row.cause);
  return out;
}

}  // namespace
}  // namespace s2r

NB_MODULE(_native, m) {
  using namespace s2r;
  nb::set_leak_warnings(false);  // objects still held by daemon threads when the interpreter ends are no news
  m.doc() = "Front end's side of the real-time core's shared memory, and the core's units for tests.";

  m.attr("MAX_JOINTS") = kMaxJoints;
  m.attr("MAX_KNOTS") = kMaxKnots;
  m.attr("PLAN_SLOTS") = kPlanSlots;
  m.attr("QUIT") = static_cast<int>(CommandKind::kQuit);
  m.attr("RAD_PER_COUNT") = kRadPerCount;
  m.attr("START_TOLERANCE_RAD") = kStartTolerance;
  m.attr("SPLICE_POSITION_RAD") = kSplicePosition;
  m.attr("SPLICE_VELOCITY_RAD_S") = kSpliceVelocity;
  m.attr("SPLICE_ACCELERATION_RAD_S2") = kSpliceAcceleration;
  m.attr("MIN_SEGMENT_S") = kMinSegment_s;
  m.attr("MAX_DURATION_S") = kMaxDuration_s;
  m.attr("MAX_STOP_S") = kMaxStop_s;
  m.attr("MAX_BUS_LOAD") = kMaxBusLoad;
  m.attr("EXECUTOR_STATES") = to_dict(kStateNames);
  m.attr("STOP_CATEGORIES") = to_dict(kStopCategoryNames);
  m.attr("CAUSES") = cause_table(false);
  m.attr("CAUSE_CATEGORIES") = cause_table(true);
  m.attr("REFUSALS") = to_dict(kRefusalNames);
  m.attr("EVENT_KINDS") = to_dict(kEventKindNames);
  m.attr("TRIGGERS") = to_dict(kTriggerNames);

  nb::class_<PySnapshot> snapshot(m, "Snapshot", "A consistent copy of the core's state after its newest tick.");
  snapshot.def_ro("alive", &PySnapshot::alive, "The core runs and has shown a sign of life within a second.")
      .def_prop_ro(
          "state", [](const PySnapshot& p) { return int(p.s.state); }, "ExecutorState number.")
      .def_prop_ro(
          "cause", [](const PySnapshot& p) { return int(p.s.cause); },
          "Cause number of the last stop or latch; 0 since the last ARM or plan start.")
      .def_prop_ro(
          "cause_joint", [](const PySnapshot& p) { return int(p.s.cause_joint); }, "-1: no joint in particular.")
      .def_prop_ro("cause_value", [](const PySnapshot& p) { return p.s.cause_value; })
      .def_prop_ro("cause_limit", [](const PySnapshot& p) { return p.s.cause_limit; })
      .def_prop_ro("tick", [](const PySnapshot& p) { return p.s.tick; })
      .def_prop_ro(
          "stamp_ns", [](const PySnapshot& p) { return p.s.stamp_ns; }, "CLOCK_MONOTONIC.")
      .def_prop_ro("epoch", [](const PySnapshot& p) { return p.s.epoch; })
      .def_prop_ro(
          "plan_id", [](const PySnapshot& p) { return p.s.plan_id; }, "Running or last plan; 0: none yet.")
      .def_prop_ro(
          "plan_t", [](const PySnapshot& p) { return p.s.plan_t; }, "Path time of that plan [s].")
      .def_prop_ro(
          "plan_done", [](const PySnapshot& p) { return p.s.plan_done != 0; },
          "That plan has ended at rest inside its goal tolerance.")
      .def_prop_ro(
          "speed_scale", [](const PySnapshot& p) { return p.s.speed_scale; },
          "Rate of path time now; between plans the rate the next one starts with.")
      .def_prop_ro(
          "speed_set", [](const PySnapshot& p) { return p.s.speed_set; },
          "Rate of path time that was asked for last; a ramp leads there, a drive's warning stays below.")
      .def_prop_ro(
          "q_ref", [](const PySnapshot& p) { return to_array(p.s.q_ref, p.dof); }, nb::rv_policy::automatic,
          "[rad], shape (dof,).")
      .def_prop_ro(
          "dq_ref", [](const PySnapshot& p) { return to_array(p.s.dq_ref, p.dof); }, nb::rv_policy::automatic,
          "[rad/s].")
      .def_prop_ro(
          "ddq_ref", [](const PySnapshot& p) { return to_array(p.s.ddq_ref, p.dof); }, nb::rv_policy::automatic,
          "[rad/s2].")
      .def_prop_ro(
          "q_meas", [](const PySnapshot& p) { return to_array(p.s.q_meas, p.dof); }, nb::rv_policy::automatic, "[rad].")
      .def_prop_ro(
          "dq_meas", [](const PySnapshot& p) { return to_array(p.s.dq_meas, p.dof); }, nb::rv_policy::automatic,
          "[rad/s].")
      .def_prop_ro(
          "tau_meas", [](const PySnapshot& p) { return to_array(p.s.tau_meas, p.dof); }, nb::rv_policy::automatic,
          "[N m].")
      .def_prop_ro(
          "drive_state", [](const PySnapshot& p) { return to_int_array(p.s.drive_state, p.dof); },
          nb::sig("def drive_state(self) -> numpy.ndarray"), "CiA 402 state numbers as in the STAT frame.")
      .def_prop_ro(
          "feedback_age", [](const PySnapshot& p) { return to_int_array(p.s.feedback_age, p.dof); },
          nb::sig("def feedback_age(self) -> numpy.ndarray"), "[ticks]; 65535: never answered.")
      .def_prop_ro(
          "overruns", [](const PySnapshot& p) { return p.s.overruns; }, "Late wake-ups that lost a tick or more.")
      .def_prop_ro(
          "missed", [](const PySnapshot& p) { return p.s.missed; }, "Ticks lost by them.")
      .def_prop_ro(
          "late_answers", [](const PySnapshot& p) { return p.s.late_answers; },
          "Drive answers that were not there when due.")
      .def_prop_ro(
          "tx_failed", [](const PySnapshot& p) { return p.s.tx_failed; }, "Ticks whose setpoint did not leave.")
      .def_prop_ro(
          "crc_errors", [](const PySnapshot& p) { return p.s.crc_errors; },
          "Frames with a wrong checksum, length or counter.")
      .def_prop_ro(
          "realtime", [](const PySnapshot& p) { return p.s.realtime != 0; },
          "SCHED_FIFO, memory lock and the CPU of the configuration obtained.")
      .def_ro("cpu", &PySnapshot::cpu, "The only CPU that the core runs on; -1: wherever the kernel puts it.")
      .def_prop_ro(
          "next_plan_id", [](const PySnapshot& p) { return p.s.next_plan_id; },
          "Plan that waits for its splice point; 0: none.")
      .def_prop_ro(
          "bus_load_foreign", [](const PySnapshot& p) { return p.s.bus_load_foreign; },
          "Share of the bus taken by frames of others.")
      .def_prop_ro("bus_load_computed", [](const PySnapshot& p) { return p.s.bus_load_computed; }, "Worst case, 0..1.");

  nb::class_<PyShared>(m, "Shared", "The memory shared with s2r-rt. One thread may submit, one may read.")
      .def_static(
          "create", [](const nb::dict& config) { return std::make_unique<PyShared>(to_config(config)); }, "config"_a,
          "Make the memory. ValueError names a bad, missing or unknown field.")
      .def_prop_ro("fd", &PyShared::fd, "Descriptor to pass to s2r-rt --shm-fd.")
      .def("beat", &PyShared::beat, "Show that the front end lives; at least every 20 ms.")
      .def("submit_plan", &PyShared::submit_plan, "plan_id"_a, "epoch"_a, "t"_a, "q"_a, "dq"_a, "ddq"_a,
           "stop_duration"_a, "path_tolerance"_a, "goal_tolerance"_a, "parent_id"_a = 0, "splice_t"_a = 0.0,
           "tau_rest"_a = nb::none(), "tau_move"_a = nb::none(),
           "Hand a plan over; the core answers by events. False: no free slot.\n\n"
           "t (n,) [s], q, dq, ddq (n, dof), stop_duration (n - 1,) [s]; a tolerance of 0 is the configured one.\n"
           "tau_rest, tau_move (n, dof): torque [N m] standing at a knot and passing it as planned, for contact.")
      .def("command", &PyShared::command, "kind"_a, "epoch"_a, "value"_a = 0.0,
           "Queue a control command (ControlKind number or QUIT). False: no room.")
      .def("snapshot", &PyShared::snapshot, "A consistent copy of the core's state.")
      .def("records", &PyShared::records, "max_records"_a = 8192,
           nb::sig("def records(self, max_records: int = 8192) -> numpy.ndarray"),
           "Take the oldest cycle records out: structured array, one per tick.")
      .def("events", &PyShared::events, "max_events"_a = 1024,
           nb::sig("def events(self, max_events: int = 1024) -> numpy.ndarray"),
           "Take the oldest events out: structured array.")
      .def_prop_ro(
          "records_dropped", [](const PyShared& s) { return s.block().records().dropped(); },
          "Records lost because nobody took them.")
      .def_prop_ro(
          "events_dropped", [](const PyShared& s) { return s.block().events().dropped(); },
          "Events lost because nobody took them.");

  nb::class_<PyCore>(m, "Core", "The real-time core without sockets or clock, stepped by a test.")
      .def(nb::init<PyShared&, std::uint64_t>(), "shared"_a, "first_tick"_a = 0, nb::keep_alive<1, 2>())
      .def("step", &PyCore::step, "frames"_a, "now_ns"_a, "skipped"_a = 0, "send_fails"_a = false,
           "One tick: frames (identifier, data, is FD) in, frames out; `skipped` ticks were lost before it.")
      .def("request_quit", &PyCore::request_quit, "As SIGTERM: stop on the path, disable, finish.")
      .def("close_bus", &PyCore::close_bus, "The other side of the bus goes away.")
      .def("all_answered", &PyCore::all_answered, "Every drive has answered the newest setpoint.")
      .def_prop_ro("finished", &PyCore::finished);

  nb::class_<PyPacking>(m, "Packing", "Frames of one packing ('fd' or 'classic').")
      .def(nb::init<const std::string&, int, double>(), "packing"_a, "dof"_a, "dt"_a = 0.001)
      .def("encode", &PyPacking::encode, "tick"_a, "seq"_a, "request"_a, "q"_a, "dq"_a, "Frames of one setpoint.")
      .def("decode", &PyPacking::decode, "id"_a, "data"_a, "fd"_a,
           "(kind, joint); kind 0 answer, 1 ignored, 2 corrupt, 3 foreign master, 4 emergency, 5 bus error, 6 bus off.")
      .def("drive", &PyPacking::drive, "joint"_a, "What is known of a drive.")
      .def("tx_allowed", &PyPacking::tx_allowed, "id"_a, "length"_a, "fd"_a, "May this frame leave the core?");

  m.def("evaluate_spline", &evaluate_spline, "t"_a, "q"_a, "dq"_a, "ddq"_a, "s"_a,
        "Quintic Hermite spline at path times s (m,): q, dq, ddq, dddq, each (m, dof).");
  m.def("sample_polynomials", &sample_polynomials, "knots"_a, "coefficients"_a, "times"_a,
        "Piecewise quintic of power-basis coefficients (segments, 6, dof), at times (m,) inside the knots:\n"
        "value and three derivatives, each (m, dof).");
  m.def("rate_ramp", &rate_ramp, "start"_a, "changes"_a, "dt"_a, "ticks"_a,
        "Rate, its slope and the path time covered, each (ticks,), with changes (tick, target, duration).");
  m.def("joint_stop", &joint_stop, "q"_a, "dq"_a, "ddq"_a, "ddq_max"_a, "dddq_max"_a, "times"_a,
        "Per-joint jerk-limited stop: durations (dof,) and q, dq, ddq (m, dof) at the times.");
  m.def("gate_check", &gate_check, "q"_a, "dq"_a, "dt"_a, "limits"_a, "margin"_a = 1.02,
        "First violation (index, cause, joint, value, limit) of setpoints (m, dof), or None; rests at the first.");
  m.def("shortest_blends", &shortest_blends, "knots"_a, "coefficients"_a, "load"_a, "load_step_s"_a, "cell_s"_a,
        "durations"_a, "ddq_limit"_a, "dddq_limit"_a, "tau_limit"_a,
        "Per segment the shortest of the durations [s] in which path time may stop or resume\n"
        "anywhere in it, NaN where there is none; the first such segment or -1, and the largest\n"
        "acceleration, jerk and torque (dof,) of the longest there. See s2r_executor.stop_ramps.");
  m.def(
      "bus_load",
      [](const std::string& packing, int dof, std::int64_t tick_ns) {
        return bus_load(to_packing(packing), check_dof(static_cast<std::size_t>(dof), "arm"), tick_ns);
      },
      "packing"_a, "dof"_a, "tick_ns"_a, "Share of the bus in the worst case of bit stuffing.");
  m.def(
      "crc16",
      [](const nb::bytes& data, std::uint8_t last) {
        return crc16({reinterpret_cast<const std::uint8_t*>(data.c_str()), data.size()}, last);
      },
      "data"_a, "last"_a, "CRC-16/CCITT-FALSE of data and one more byte.");
  m.def(
      "controlword",
      [](int request, int state) {
        return classic::controlword(static_cast<DriveRequest>(request), static_cast<DriveState>(state));
      },
      "request"_a, "state"_a, "CiA 402 controlword for a request to a drive in this state.");
  m.def(
      "drive_state", [](std::uint16_t statusword) { return static_cast<int>(classic::drive_state(statusword)); },
      "statusword"_a, "CiA 402 state number of a statusword.");
  m.def(
      "next_state",
      [](int state, int trigger) {
        return static_cast<int>(next_state(static_cast<State>(state), static_cast<Trigger>(trigger)));
      },
      "state"_a, "trigger"_a, "The state machine.");
}
