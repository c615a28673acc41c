// Little-endian fields in a byte buffer, without alignment or aliasing traps.
#pragma once

#include <array>
#include <concepts>
#include <cstddef>
#include <cstdint>

namespace s2r {

template <std::integral T>
constexpr void put(std::array<std::uint8_t, 64>& data, std::size_t at, T value) noexcept {
  const auto bits = static_cast<std::uint64_t>(value);
  for (std::size_t i = 0; i < sizeof(T); ++i) data[at + i] = static_cast<std::uint8_t>(bits >> (8 * i));
}

template <std::integral T>
constexpr T get(const std::array<std::uint8_t, 64>& data, std::size_t at) noexcept {
  std::uint64_t bits = 0;
  for (std::size_t i = 0; i < sizeof(T); ++i) bits |= static_cast<std::uint64_t>(data[at + i]) << (8 * i);
  return static_cast<T>(bits);
}

}  // namespace s2r
