// s2r_fuzz: arbitrary bytes into everything that reads bytes or numbers from outside.
//
// With clang: one libFuzzer target for all (-fsanitize=fuzzer), the first byte chooses the decoder.
// Without: `s2r_fuzz SEED COUNT` feeds seeded inputs, random ones and valid ones with a few bytes changed.
// A decoder must not crash, and must not take what is damaged: checked here against an encoder of its own.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <memory>
#include <random>

#include "bytes.hpp"
#include "config.hpp"
#include "core.hpp"
#include "packing.hpp"
#include "plan_check.hpp"

namespace s2r {
namespace {

[[noreturn]] void fail(const char* what) {
  std::fprintf(stderr, "fuzz: %s\n", what);
  std::abort();
}

Config make_config() {
  Config config;
  config.dof = kMaxJoints;
  config.tick_ns = 1'000'000;
  for (int joint = 0; joint < kMaxJoints; ++joint) {
    config.limits.q_min[joint] = -2.9;
    config.limits.q_max[joint] = 2.9;
    config.limits.dq_max[joint] = 3.0;
    config.limits.ddq_max[joint] = 6.0;
    config.limits.dddq_max[joint] = 300.0;
    config.limits.tau_max[joint] = 100.0;
  }
  return config;
}

std::uint64_t accepted = 0;

Frame to_frame(const std::uint8_t* data, std::size_t size) {
  Frame frame;
  if (size < 6) return frame;
  frame.id = (std::uint32_t{data[0]} | std::uint32_t{data[1]} << 8) & 0x7FFU;
  frame.fd = (data[2] & 1U) != 0U;
  frame.error = (data[2] & 2U) != 0U;
  frame.length = std::min<std::uint8_t>(data[3], 64);
  std::memcpy(frame.data.data(), data + 4, std::min<std::size_t>(size - 4, 64));
  return frame;
}

// STAT: only a frame whose CRC an independent computation confirms may change what is known of a drive.
void answer(const std::uint8_t* data, std::size_t size) {
  PackingFd packing;
  packing.configure(kMaxJoints);
  PerJoint<JointFeedback> drives{};
  DriveCommand sent;
  sent.tick = 70'000;
  sent.seq = 9;
  const Frame frame = to_frame(data, size);
  const RxResult result = packing.unpack(frame, sent, drives);
  int known = 0;
  for (const JointFeedback& drive : drives) known += drive.seen ? 1 : 0;
  if ((result.kind == RxKind::kAnswer) != (known == 1)) fail("an answer that was none");
  if (result.kind != RxKind::kAnswer) return;
  ++accepted;
  std::uint32_t crc = 0xFFFFU;  // bit by bit, not the library's
  for (int i = 0; i < 15; ++i) {
    crc ^=
        std::uint32_t{i < 14 ? frame.data[static_cast<std::size_t>(i)] : static_cast<std::uint8_t>(frame.id - 0x180U)}
        << 8;
    for (int bit = 0; bit < 8; ++bit) crc = ((crc << 1) ^ ((crc & 0x8000U) != 0U ? 0x1021U : 0U)) & 0xFFFFU;
  }
  if (!frame.fd || frame.length != 16 || frame.error) fail("an answer in the wrong frame");
  if (crc != (frame.data[14] | std::uint32_t{frame.data[15]} << 8)) fail("an answer with a wrong checksum");
  if ((frame.data[1] & 0x0FU) > 7) fail("an answer with a state that does not exist");
}

void classic_answer(const std::uint8_t* data, std::size_t size) {
  PackingClassic packing;
  packing.configure(kMaxJoints, 0.004);
  PerJoint<JointFeedback> drives{};
  DriveCommand sent;
  sent.tick = 12;
  const Frame frame = to_frame(data, size);
  const RxResult result = packing.unpack(frame, sent, drives);
  if (result.kind == RxKind::kAnswer && (frame.length != 8 || result.joint < 0 || result.joint >= kMaxJoints))
    fail("a TPDO1 of another length");
  for (const JointFeedback& drive : drives)
    if (!std::isfinite(drive.q) || !std::isfinite(drive.dq) || !std::isfinite(drive.tau)) fail("not a number");
}

// Bytes as a plan in shared memory: what passes must be finite, rising, at rest at its end and inside the limits.
void plan(const std::uint8_t* data, std::size_t size) {
  static const auto config = std::make_unique<Config>(make_config());
  static const auto plan = std::make_unique<Plan>();
  plan->dof = kMaxJoints;
  plan->knots = 2 + (size > 0 ? data[0] % 4 : 0);
  std::size_t at = 1;
  const auto number = [&](double& out) {
    if (at + 8 <= size) std::memcpy(&out, data + at, 8);
    at += 8;
  };
  for (std::size_t i = 0; i < static_cast<std::size_t>(plan->knots); ++i) {
    plan->t[i] = static_cast<double>(i);
    plan->stop_duration[i] = 0.5;
    plan->q[i] = plan->dq[i] = plan->ddq[i] = {};
  }
  for (std::size_t i = 0; i < static_cast<std::size_t>(plan->knots); ++i) {
    number(plan->t[i]);
    number(plan->stop_duration[i]);
    number(plan->q[i][static_cast<int>(i % 7)]);
    number(plan->dq[i][static_cast<int>(i % 7)]);
    number(plan->ddq[i][static_cast<int>(i % 7)]);
  }
  number(plan->path_tolerance);
  number(plan->splice_t);
  if (check_plan(*plan, *config)) return;
  ++accepted;
  for (std::size_t i = 0; i < static_cast<std::size_t>(plan->knots); ++i) {
    if (i > 0 && !(plan->t[i] > plan->t[i - 1])) fail("a plan whose time does not rise");
    for (int joint = 0; joint < kMaxJoints; ++joint) {
      if (!(plan->q[i][joint] >= -2.9 && plan->q[i][joint] <= 2.9)) fail("a plan outside its position limits");
      if (!(std::abs(plan->dq[i][joint]) <= 3.0 * 1.02)) fail("a plan outside its velocity limits");
      if (!(std::abs(plan->ddq[i][joint]) <= 6.0 * 1.02)) fail("a plan outside its acceleration limits");
    }
  }
  const auto last = static_cast<std::size_t>(plan->knots - 1);
  for (int joint = 0; joint < kMaxJoints; ++joint)
    if (!(std::abs(plan->dq[last][joint]) <= 1e-6)) fail("a plan that ends in motion");
}

// A setpoint of any numbers: what the encoder calls ok must decode to the same within half a count.
void setpoint(const std::uint8_t* data, std::size_t size) {
  double q = 0.0, dq = 0.0;
  if (size >= 16) {
    std::memcpy(&q, data, 8);
    std::memcpy(&dq, data + 8, 8);
  }
  const EncodedJoint joint = encode_joint(q, dq);
  if (!joint.ok) return;
  ++accepted;
  if (!(std::abs(decode_position(joint.position) - q) <= 0.51 * kRadPerCount)) fail("a position that changed");
  if (!(std::abs(decode_velocity(joint.velocity) - dq) <= 0.51 * kRadPerSecondPerCount))
    fail("a velocity that changed");
}

// Three setpoints of any bytes into the gate: what it lets pass after rest is inside position and velocity.
void gate(const std::uint8_t* data, std::size_t size) {
  static const Config config = make_config();
  Gate gate;
  gate.configure(config.limits, 1, 1e-3, 1.02);
  EncodedSetpoint setpoint{};
  gate.reset(setpoint);
  double last = 0.0;
  for (std::size_t i = 0; i + 6 <= size && i < 36; i += 6) {
    std::memcpy(&setpoint[0].position, data + i, 4);
    std::memcpy(&setpoint[0].velocity, data + i + 4, 2);
    if ((data[i] & 3U) != 0U) setpoint[0].position = static_cast<std::int32_t>(last) + (data[i + 1] - 128) * 4;
    if (gate.check(setpoint)) continue;
    ++accepted;
    gate.commit(setpoint);
    const double now = setpoint[0].position;
    if (!(std::abs(now * kRadPerCount) <= 2.9 + kRadPerCount)) fail("a setpoint outside its position limits");
    if (!(std::abs(now - last) * kRadPerCount <= 3.0 * 1.02 * 1e-3 + kRadPerCount)) fail("a setpoint too fast");
    last = now;
  }
}

// Any configuration: what passes must be usable.
void configuration(const std::uint8_t* data, std::size_t size) {
  Config config = make_config();
  const char bus[] = "unix:x";
  std::copy(std::begin(bus), std::end(bus), config.bus.begin());
  const auto number = [&](std::size_t index, double& out) {
    if (8 * (index + 1) + 2 <= size) std::memcpy(&out, data + 2 + 8 * index, 8);
  };
  if (size > 1) config.dof = static_cast<int>(data[0]) - 128;
  if (size > 1) config.tick_ns = data[1] * 20'000LL;
  number(0, config.pace);
  number(1, config.gate_margin);
  number(2, config.path_tolerance_rad);
  number(3, config.limits.q_min[0]);
  number(4, config.limits.dq_max[0]);
  number(5, config.front_end_timeout_s);
  if (!find_fault(config).empty()) return;
  ++accepted;
  if (config.dof < 1 || config.dof > kMaxJoints || !(config.gate_margin <= 1.2) || !(config.limits.dq_max[0] > 0.0))
    fail("a configuration that cannot be");
}

constexpr std::array kTargets{answer, classic_answer, plan, setpoint, gate, configuration};

}  // namespace
}  // namespace s2r

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size < 1) return 0;
  s2r::kTargets[data[0] % s2r::kTargets.size()](data + 1, size - 1);
  return 0;
}

#ifndef S2R_LIBFUZZER
namespace {

// A valid STAT for the first decoder, so that single changes meet the checks behind the checksum.
std::size_t valid_answer(std::uint8_t* out, std::mt19937_64& random) {
  using namespace s2r;
  Frame frame;
  const auto node = static_cast<std::uint8_t>(1 + random() % 7);
  put(frame.data, 0, std::uint8_t{9});
  put(frame.data, 1, static_cast<std::uint8_t>(random() % 8 | 0x10U));
  put(frame.data, 2, static_cast<std::int32_t>(random()));
  put(frame.data, 10, static_cast<std::uint16_t>(70'000));
  put(frame.data, 14, crc16(std::span<const std::uint8_t>(frame.data).first(14), node));
  out[0] = 0;
  out[1] = static_cast<std::uint8_t>(0x80U + node);
  out[2] = 1;
  out[3] = 1;
  out[4] = 16;
  std::memcpy(out + 5, frame.data.data(), 64);
  return 69;
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 3) {
    std::fprintf(stderr, "usage: s2r_fuzz SEED COUNT\n");
    return 2;
  }
  std::mt19937_64 random(std::strtoull(argv[1], nullptr, 10));
  const std::uint64_t count = std::strtoull(argv[2], nullptr, 10);
  std::array<std::uint8_t, 256> input{};
  for (std::uint64_t i = 0; i < count; ++i) {
    std::size_t size = random() % input.size();
    for (std::size_t k = 0; k < input.size(); k += 8) {
      const std::uint64_t word = random();
      std::memcpy(input.data() + k, &word, 8);
    }
    if (i % 3 == 0) {
      size = valid_answer(input.data(), random);
      const int changes = static_cast<int>(random() % 4);
      for (int k = 0; k < changes; ++k)
        input[1 + random() % (size - 1)] ^= static_cast<std::uint8_t>(1U << (random() % 8));
    } else if (i % 3 == 1) {  // numbers of plausible size rather than any bits
      for (std::size_t k = 2; k + 8 <= input.size(); k += 8) {
        const double value =
            static_cast<double>(static_cast<std::int64_t>(random())) * 0x1p-63 * (random() % 4 == 0 ? 1e300 : 3.0);
        std::memcpy(input.data() + k, &value, 8);
      }
    }
    LLVMFuzzerTestOneInput(input.data(), size);
  }
  std::printf("%llu inputs, %llu of them valid\n", static_cast<unsigned long long>(count),
              static_cast<unsigned long long>(s2r::accepted));
  return 0;
}
#endif
