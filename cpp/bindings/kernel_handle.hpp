/// @file
/// A kernel from a separate module, as Python passes it around.
#pragma once

#include "bindings.hpp"

#include "kernel.hpp"

namespace hexservo::bindings {

/// Refers to a table that lives as long as its module, which Python never unloads.
class KernelHandle {
 public:
  explicit KernelHandle(const py::capsule& capsule);

  const Kernel& table() const { return *table_; }

 private:
  const Kernel* table_;
};

}  // namespace hexservo::bindings
