#include "packing.hpp"

#include <cmath>
#include <limits>

namespace s2r {
namespace {

template <class Int>
bool encode(double value, double per_count, Int& counts) noexcept {
  const double scaled = std::round(value / per_count);
  if (!(std::abs(scaled) <= static_cast<double>(std::numeric_limits<Int>::max()))) return false;  // NaN as well
  counts = static_cast<Int>(scaled);
  return true;
}

constexpr std::array<std::uint32_t, 256> make_crc32_table() noexcept {
  std::array<std::uint32_t, 256> table{};
  for (std::uint32_t i = 0; i < 256; ++i) {
    std::uint32_t c = i;
    for (int bit = 0; bit < 8; ++bit) c = (c >> 1) ^ ((c & 1U) != 0U ? 0xEDB88320U : 0U);
    table[i] = c;
  }
  return table;
}
constexpr auto kCrc32Table = make_crc32_table();

// Bits of a classical data frame with 11-bit id and n data bytes, worst stuffing, 3 bits of interframe space.
constexpr int classic_bits(int n) noexcept { return 44 + 8 * n + (34 + 8 * n - 1) / 4 + 3; }

// Seconds of an FD frame with bit-rate switch at 1 / 5 Mbit/s, worst stuffing. Arbitration phase: SOF..BRS 17 bits
// with 4 stuff bits, then CRC delimiter, ACK, EOF and interframe space, 13 bits. Data phase: ESI, DLC, data with a
// stuff bit every 4, stuff count 4, CRC 17 or 21 with 6 or 7 fixed stuff bits (ISO 11898-1).
constexpr double fd_seconds(int n) noexcept {
  const int crc = n > 16 ? 21 + 7 : 17 + 6;
  const int data_bits = 5 + 8 * n + (5 + 8 * n) / 4 + 4 + crc;
  return 34 / 1e6 + data_bits / 5e6;
}

}  // namespace

EncodedJoint encode_joint(double q, double dq) noexcept {
  EncodedJoint out;
  const bool position_fits = encode(q, kRadPerCount, out.position);
  const bool velocity_fits = encode(dq, kRadPerSecondPerCount, out.velocity);
  out.ok = position_fits && velocity_fits;
  return out;
}

std::uint32_t crc32(std::span<const std::uint8_t> first, std::span<const std::uint8_t> second) noexcept {
  std::uint32_t c = 0xFFFFFFFFU;
  for (const auto part : {first, second})
    for (const std::uint8_t byte : part) c = kCrc32Table[(c ^ byte) & 0xFFU] ^ (c >> 8);
  return c ^ 0xFFFFFFFFU;
}

std::uint16_t crc16(std::span<const std::uint8_t> data, std::uint8_t last) noexcept {
  std::uint32_t c = 0xFFFFU;
  const auto feed = [&c](std::uint8_t byte) {
    c ^= static_cast<std::uint32_t>(byte) << 8;
    for (int bit = 0; bit < 8; ++bit) c = ((c << 1) ^ ((c & 0x8000U) != 0U ? 0x1021U : 0U)) & 0xFFFFU;
  };
  for (const std::uint8_t byte : data) feed(byte);
  feed(last);
  return static_cast<std::uint16_t>(c);
}

double frame_seconds(const Frame& frame) noexcept {
  if (frame.error) return 0.0;
  return frame.fd ? fd_seconds(frame.length) : 1e-6 * classic_bits(frame.length);
}

double bus_load(PackingKind packing, int dof, std::int64_t tick_ns) noexcept {
  const double tick_s = 1e-9 * static_cast<double>(tick_ns);
  if (packing == PackingKind::kFd) return (fd_seconds(64) + dof * fd_seconds(16)) / tick_s;
  const double bit_s = 1e-6;
  const double per_tick = 2 * dof * classic_bits(8) + classic_bits(1);  // RPDO1 and TPDO1, SYNC
  const double torque = dof * classic_bits(5) / 8.0;                    // TPDO2 every 8th SYNC
  const double heartbeat = dof * classic_bits(1) / 0.1;                 // per second
  return (per_tick + torque) * bit_s / tick_s + heartbeat * bit_s;
}

}  // namespace s2r
