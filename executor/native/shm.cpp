#include "shm.hpp"

#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <new>
#include <stdexcept>
#include <string>
#include <system_error>
#include <utility>

namespace s2r {
namespace {

// MAP_POPULATE: all pages are there before the first tick.
void* map(int fd, std::size_t size) {
  void* address = ::mmap(nullptr, size, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_POPULATE, fd, 0);
  if (address == MAP_FAILED) throw std::system_error(errno, std::generic_category(), "mmap of the shared block");
  return address;
}

}  // namespace

SharedMemory::SharedMemory(int fd, void* address, std::size_t size) noexcept
    : fd_(fd), block_(static_cast<SharedBlock*>(address)), size_(size) {}

SharedMemory::SharedMemory(SharedMemory&& other) noexcept
    : fd_(std::exchange(other.fd_, -1)), block_(std::exchange(other.block_, nullptr)), size_(other.size_) {}

SharedMemory::~SharedMemory() {
  if (block_ != nullptr) ::munmap(block_, size_);
  if (fd_ >= 0) ::close(fd_);
}

void SharedMemory::release() const noexcept { ::madvise(block_, size_, MADV_DONTNEED); }

SharedMemory SharedMemory::create(const Config& config) {
  const std::size_t size = SharedBlock::total_size(config.record_capacity);
  const int fd = ::memfd_create("s2r-rt", MFD_CLOEXEC);
  if (fd < 0) throw std::system_error(errno, std::generic_category(), "memfd_create");
  if (::ftruncate(fd, static_cast<off_t>(size)) != 0) {
    const int error = errno;
    ::close(fd);
    throw std::system_error(error, std::generic_category(), "ftruncate of the shared block");
  }
  SharedMemory memory(fd, map(fd, size), size);
  auto* block = new (memory.block_) SharedBlock;
  block->layout_size = sizeof(SharedBlock);
  block->config = config;
  return memory;
}

SharedMemory SharedMemory::open(int fd) {
  struct stat status{};
  if (::fstat(fd, &status) != 0)
    throw std::system_error(errno, std::generic_category(), "descriptor " + std::to_string(fd) + " of --shm-fd");
  const auto size = static_cast<std::size_t>(status.st_size);
  if (size < sizeof(SharedBlock))
    throw std::runtime_error("the shared block has " + std::to_string(size) + " bytes, expected at least " +
                             std::to_string(sizeof(SharedBlock)) + "; are front end and s2r-rt of one build?");
  SharedMemory memory(fd, map(fd, size), size);
  const SharedBlock& block = memory.block();
  if (block.magic != SharedBlock::kMagic || block.layout_size != sizeof(SharedBlock) ||
      size != SharedBlock::total_size(block.config.record_capacity))
    throw std::runtime_error("the shared block has another layout; are front end and s2r-rt of one build?");
  return memory;
}

}  // namespace s2r
