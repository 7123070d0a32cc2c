#include "hexservo/buffer.hpp"

#include <cstdlib>
#include <new>

#ifdef __linux__
#include <sys/mman.h>
#endif

namespace hexservo {

namespace {

constexpr std::size_t kHugePage = std::size_t{2} << 20;
constexpr std::size_t kCacheLine = 64;
constexpr std::size_t kLarge = kHugePage / 2;  // worth a separate huge page

}  // namespace

Buffer::Buffer(std::size_t size) : size_(size) {
  if (size == 0) return;
  if (size > static_cast<std::size_t>(-1) / sizeof(double) - kHugePage) throw std::bad_alloc();
  const std::size_t bytes = size * sizeof(double);
  const std::size_t alignment = bytes >= kLarge ? kHugePage : kCacheLine;
  const std::size_t rounded = (bytes + alignment - 1) / alignment * alignment;
  void* block = std::aligned_alloc(alignment, rounded);
  if (block == nullptr) throw std::bad_alloc();
#ifdef MADV_HUGEPAGE
  if (alignment == kHugePage) madvise(block, rounded, MADV_HUGEPAGE);  // a refusal costs time, no more
#endif
  data_.reset(static_cast<double*>(block), std::free);
}

}  // namespace hexservo
