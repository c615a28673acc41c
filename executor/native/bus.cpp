#include "bus.hpp"

#include <linux/can.h>
#include <linux/can/error.h>
#include <linux/can/raw.h>
#include <net/if.h>
#include <poll.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <string>
#include <system_error>
#include <utility>

namespace s2r {
namespace {

static_assert(kErrorClassBusOff == CAN_ERR_BUSOFF);

class SocketBus final : public Bus {
 public:
  explicit SocketBus(int fd) noexcept : fd_(fd) {
    for (std::size_t i = 0; i < kBatch; ++i) {
      rx_vectors_[i] = {.iov_base = &rx_frames_[i], .iov_len = sizeof(canfd_frame)};
      tx_vectors_[i] = {.iov_base = &tx_frames_[i], .iov_len = 0};
      rx_messages_[i].msg_hdr.msg_iov = &rx_vectors_[i];
      rx_messages_[i].msg_hdr.msg_iovlen = 1;
      tx_messages_[i].msg_hdr.msg_iov = &tx_vectors_[i];
      tx_messages_[i].msg_hdr.msg_iovlen = 1;
    }
  }
  SocketBus(const SocketBus&) = delete;
  SocketBus& operator=(const SocketBus&) = delete;
  ~SocketBus() override { ::close(fd_); }

  Rx receive(Frame& frame) noexcept override {
    if (next_ == received_) {
      if (closed_) return Rx::kClosed;
      if (std::exchange(drained_, false)) return Rx::kEmpty;  // the last call left nothing behind: spare asking again
      const int n = ::recvmmsg(fd_, rx_messages_.data(), kBatch, MSG_DONTWAIT, nullptr);
      next_ = received_ = 0;
      if (n < 0) {
        closed_ = errno != EAGAIN && errno != EINTR && errno != ENETDOWN && errno != ENOBUFS;
        return closed_ ? Rx::kClosed : Rx::kEmpty;
      }
      received_ = static_cast<std::size_t>(n);
      drained_ = received_ < kBatch;
    }
    const std::size_t i = next_++;
    if (rx_messages_[i].msg_len == 0) {  // end of a SEQPACKET stream
      closed_ = true;
      next_ = received_ = 0;
      return Rx::kClosed;
    }
    frame = decode(rx_frames_[i], rx_messages_[i].msg_len);
    return Rx::kFrame;
  }

  int send(std::span<const Frame> frames) noexcept override {
    const std::size_t count = std::min(frames.size(), kBatch);
    for (std::size_t i = 0; i < count; ++i) {
      encode(frames[i], tx_frames_[i]);
      tx_vectors_[i].iov_len = frames[i].fd ? CANFD_MTU : CAN_MTU;
    }
    // ENOBUFS and EAGAIN: the queue is full. The caller counts; nothing is retried, the next setpoint is newer.
    const int sent = ::sendmmsg(fd_, tx_messages_.data(), static_cast<unsigned>(count), MSG_DONTWAIT | MSG_NOSIGNAL);
    return std::max(sent, 0);
  }

  bool wait(int timeout_ms) noexcept override {
    if (next_ != received_) return true;
    pollfd item{.fd = fd_, .events = POLLIN, .revents = 0};
    return ::poll(&item, 1, timeout_ms) > 0;
  }

 private:
  static constexpr std::size_t kBatch = 16;

  static void encode(const Frame& frame, canfd_frame& raw) noexcept {
    raw = canfd_frame{};  // a can_frame has its length and data at the same places
    raw.can_id = frame.id;
    raw.len = frame.length;
    raw.flags = frame.fd ? CANFD_BRS : 0;
    std::memcpy(raw.data, frame.data.data(), frame.length);
  }

  static Frame decode(const canfd_frame& raw, unsigned size) noexcept {
    Frame frame;
    frame.fd = size == CANFD_MTU;
    frame.error = (raw.can_id & CAN_ERR_FLAG) != 0U;
    const bool data_frame = size == CANFD_MTU || size == CAN_MTU;
    const bool standard = (raw.can_id & (CAN_EFF_FLAG | CAN_RTR_FLAG)) == 0U;
    frame.id = frame.error ? raw.can_id & CAN_ERR_MASK : raw.can_id & CAN_SFF_MASK;
    if (!data_frame || !(standard || frame.error)) frame.id = kNoId;
    frame.length = std::min<std::uint8_t>(raw.len, frame.fd ? CANFD_MAX_DLEN : CAN_MAX_DLEN);
    std::memcpy(frame.data.data(), raw.data, frame.length);
    return frame;
  }

  static constexpr std::uint32_t kNoId = 0xFFFF'FFFFU;  // matches no identifier: ignored by every packing
  int fd_;
  bool closed_ = false, drained_ = false;
  std::size_t next_ = 0, received_ = 0;
  std::array<canfd_frame, kBatch> rx_frames_{}, tx_frames_{};
  std::array<iovec, kBatch> rx_vectors_{}, tx_vectors_{};
  std::array<mmsghdr, kBatch> rx_messages_{}, tx_messages_{};
};

[[noreturn]] void fail(int fd, std::string_view address, const char* what) {
  const int error = errno;
  if (fd >= 0) ::close(fd);
  throw std::system_error(error, std::generic_category(), "bus '" + std::string(address) + "': " + what);
}

int open_unix(std::string_view address, std::string_view path) {
  sockaddr_un where{};
  where.sun_family = AF_UNIX;
  if (path.size() >= sizeof(where.sun_path)) {
    errno = ENAMETOOLONG;
    fail(-1, address, "socket path");
  }
  std::memcpy(where.sun_path, path.data(), path.size());
  const int fd = ::socket(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0);
  if (fd < 0) fail(fd, address, "socket");
  if (::connect(fd, reinterpret_cast<const sockaddr*>(&where), sizeof(where)) != 0) fail(fd, address, "connect");
  return fd;
}

int open_can(std::string_view address, const std::string& interface) {
  const int fd = ::socket(AF_CAN, SOCK_RAW | SOCK_CLOEXEC, CAN_RAW);
  if (fd < 0) fail(fd, address, "socket");
  const int on = 1;
  const can_err_mask_t errors = CAN_ERR_MASK;
  if (::setsockopt(fd, SOL_CAN_RAW, CAN_RAW_FD_FRAMES, &on, sizeof(on)) != 0) fail(fd, address, "CAN FD frames");
  if (::setsockopt(fd, SOL_CAN_RAW, CAN_RAW_ERR_FILTER, &errors, sizeof(errors)) != 0)
    fail(fd, address, "error frames");
  sockaddr_can where{};
  where.can_family = AF_CAN;
  where.can_ifindex = static_cast<int>(::if_nametoindex(interface.c_str()));
  if (where.can_ifindex == 0) fail(fd, address, "no such interface");
  if (::bind(fd, reinterpret_cast<const sockaddr*>(&where), sizeof(where)) != 0) fail(fd, address, "bind");
  return fd;
}

}  // namespace

std::unique_ptr<Bus> open_bus(std::string_view address) {
  if (address.starts_with("unix:")) return std::make_unique<SocketBus>(open_unix(address, address.substr(5)));
  if (address.starts_with("can:"))
    return std::make_unique<SocketBus>(open_can(address, std::string(address.substr(4))));
  errno = EINVAL;
  fail(-1, address, "expected unix:PATH or can:INTERFACE");
}

}  // namespace s2r
