#include "bindings.hpp"

#include <Eigen/Core>

namespace py = pybind11;
using namespace hexservo::bindings;

PYBIND11_MODULE(_core, m) {
  m.doc() = "Compiled core of hexservo. Private: use the names of the package hexservo.";
  bind_rigid_body(m);
  bind_hexapod(m);
  bind_camera(m);
  bind_fuzzy(m);
  bind_settings(m);
  bind_kernel(m);
  bind_simulation(m);
  bind_sampled_run(m);
  bind_drives(m);
  bind_probe(m);
  bind_batch(m);
  bind_controller(m);
  bind_bench(m);
  m.def(
      "build_info",
      [] {
        py::dict info;
        info["hexservo"] = HEXSERVO_VERSION;
        info["compiler"] = HEXSERVO_COMPILER;
        info["flags"] = HEXSERVO_FLAGS;
        info["eigen"] = std::to_string(EIGEN_WORLD_VERSION) + "." + std::to_string(EIGEN_MAJOR_VERSION) + "." +
                        std::to_string(EIGEN_MINOR_VERSION);
        return info;
      },
      "Version of hexservo, compiler, flags and Eigen of this build, as text.");
}
