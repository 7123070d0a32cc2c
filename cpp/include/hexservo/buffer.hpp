/// @file
/// A block of doubles that is written once and then shared: logs and the results of batches.
#pragma once

#include <cstddef>
#include <memory>
#include <span>

namespace hexservo {

/// Doubles that start out without a value, so that a page is touched when it is written; copies share them.
///
/// A large block lies on huge pages where the system gives them: the faults of small ones were most of what logging
/// costs.
class Buffer {
 public:
  Buffer() = default;
  /// @throws std::bad_alloc
  explicit Buffer(std::size_t size);

  double* data() const noexcept { return data_.get(); }
  std::size_t size() const noexcept { return size_; }
  bool empty() const noexcept { return size_ == 0; }
  double& operator[](std::size_t i) const noexcept { return data_.get()[i]; }
  std::span<double> span() const noexcept { return {data_.get(), size_}; }

 private:
  std::shared_ptr<double> data_;
  std::size_t size_ = 0;
};

}  // namespace hexservo
