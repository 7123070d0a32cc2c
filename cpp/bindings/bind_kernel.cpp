#include "kernel_handle.hpp"

#include <cstring>

namespace hexservo::bindings {

KernelHandle::KernelHandle(const py::capsule& capsule) {
  const char* name = capsule.name();
  if (name == nullptr || std::strcmp(name, kKernelCapsule) != 0)
    throw std::invalid_argument("capsule: expected a hexservo kernel, got another one");
  table_ = capsule.get_pointer<const Kernel>();
  if (table_->abi != kKernelAbi)
    throw std::invalid_argument("capsule: expected a kernel of this build, got one of another");
}

namespace {

/// Instruction sets that processor and operating system offer. Asked here, in code that runs on every processor.
py::dict processor_features() {
  py::dict features;
#if defined(__x86_64__)
  __builtin_cpu_init();
  features["avx2"] = __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma");
  features["avx512"] = __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512vl") &&
                       __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512bw") &&
                       __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma");
#endif
  return features;
}

}  // namespace

void bind_kernel(py::module_& m) {
  py::class_<KernelHandle>(m, "Kernel", "The run loop compiled for one instruction set.")
      .def(py::init<const py::capsule&>(), py::arg("capsule"), "From the attribute `kernel` of a module _core_<name>.")
      .def_property_readonly("name", [](const KernelHandle& k) { return k.table().name; })
      .def_property_readonly(
          "lanes", [](const KernelHandle& k) { return k.table().lanes; }, "scenarios in one vector register")
      .def_property_readonly(
          "flags", [](const KernelHandle& k) { return k.table().flags; }, "of the compiler")
      .def(
          "fma_peak", [](const KernelHandle& k, double seconds) { return k.table().fma_peak(seconds); },
          py::arg("seconds") = 0.1, py::call_guard<WithoutGil>(),
          "Measured peak of one core in vector multiply-adds [GFLOP/s].");

  m.def("processor_features", &processor_features,
        "Kernels that need more than the baseline, and whether processor and operating system can run them.");
}

}  // namespace hexservo::bindings
