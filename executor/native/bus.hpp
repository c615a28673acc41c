// The bus: the only place that knows sockets. SocketCAN frames over AF_CAN, or the same frames over a local
// SOCK_SEQPACKET socket (the stand-in listens there).
#pragma once

#include <memory>
#include <span>
#include <string_view>

#include "packing.hpp"

namespace s2r {

enum class Rx : std::uint8_t { kFrame, kEmpty, kClosed };

// Non-blocking. The core is written against this; tests put a queue behind it.
class FramePort {
 public:
  virtual ~FramePort() = default;
  virtual Rx receive(Frame& frame) noexcept = 0;
  // Number of frames that left, in order; fewer than given: the queue is full or the bus is gone.
  virtual int send(std::span<const Frame> frames) noexcept = 0;
};

class Bus : public FramePort {
 public:
  // Sleeps until a frame is there, at most timeout_ms. False: nothing came.
  virtual bool wait(int timeout_ms) noexcept = 0;
};

// "unix:PATH" or "can:INTERFACE". Throws std::system_error naming the address.
std::unique_ptr<Bus> open_bus(std::string_view address);

}  // namespace s2r
