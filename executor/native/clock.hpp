// When the next tick happens: at absolute deadlines (real), or as soon as the answers to the last one are in
// (lock-step).
#pragma once

#include <atomic>

#include "bus.hpp"
#include "core.hpp"

namespace s2r {

std::int64_t monotonic_ns() noexcept;

// Runs the core until it has finished. `stop_requested` may be set from a signal handler; if the drives are not off
// within the configured `quit_timeout_s` of that, the loop ends all the same and their own watchdogs stop the arm.
void run(Core& core, Bus& bus, const Config& config, const std::atomic<bool>& stop_requested) noexcept;

}  // namespace s2r
