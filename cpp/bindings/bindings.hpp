/// @file
/// What the binding files share. Bindings convert and check shapes; they compute nothing.
#pragma once

#include "hexservo/rigid_body.hpp"
#include "weight_rows.hpp"

#include <pybind11/eigen.h>
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <cxxabi.h>

#include <chrono>
#include <functional>
#include <stdexcept>
#include <string>
#include <string_view>
#include <thread>

namespace hexservo::bindings {

namespace py = pybind11;

void bind_hexapod(py::module_& m);
void bind_rigid_body(py::module_& m);
void bind_camera(py::module_& m);
void bind_fuzzy(py::module_& m);
void bind_settings(py::module_& m);
void bind_simulation(py::module_& m);
void bind_sampled_run(py::module_& m);
void bind_drives(py::module_& m);
void bind_probe(py::module_& m);
void bind_controller(py::module_& m);
void bind_kernel(py::module_& m);
void bind_batch(py::module_& m);
void bind_bench(py::module_& m);

/// Calls `f`, which takes the GIL or runs Python's code. A daemon thread that does so once the interpreter ends is
/// ended there, up to Python 3.13, by an unwinding that the frames below do not let through, which would abort the
/// program. It stands still here until the program ends, as Python 3.14 has it.
template <class F>
auto or_stand_still(const F& f) {
  try {
    return f();
  }
#ifdef __GLIBCXX__
  catch (const abi::__forced_unwind&) {
    while (true) std::this_thread::sleep_for(std::chrono::hours(1));
  }
#endif
}

/// Other threads of Python run meanwhile.
class WithoutGil {
 public:
  WithoutGil() : state_(PyEval_SaveThread()) {}
  WithoutGil(const WithoutGil&) = delete;
  WithoutGil& operator=(const WithoutGil&) = delete;
  ~WithoutGil() {
    or_stand_still([this] { PyEval_RestoreThread(state_); });
  }

 private:
  PyThreadState* state_;
};

/// What a run asks between steps: whether Ctrl-C was pressed. Anything else that a signal handler raises goes on to the
/// caller. Empty in any thread but Python's main one, the only one that signals reach. To be called with the GIL; its
/// answer takes it.
std::function<bool()> interrupt_question();

inline py::str text(std::string_view view) { return {view.data(), view.size()}; }

/// Passes on a fixed-size array whose entries are all finite.
template <class Derived>
void require_finite(const char* name, const Eigen::MatrixBase<Derived>& value) {
  if (!value.allFinite())
    throw std::invalid_argument(std::string(name) + ": expected finite numbers, got NaN or infinity");
}

/// Whether an array holds text, complex numbers or booleans: a conversion would turn digits and truth into numbers, or
/// leave out imaginary parts.
inline bool holds_no_real_numbers(const py::array& array) {
  return std::string_view("SUcb").find(array.dtype().kind()) != std::string_view::npos;
}

/// What was given in place of numbers, for messages.
inline std::string kind_of(const py::object& value) {
  if (py::isinstance<py::array>(value))
    return "an array of " + std::string(py::str(py::reinterpret_borrow<py::array>(value).dtype()));
  return "something else (" + std::string(py::str(py::type::of(value).attr("__name__"))) + ")";
}

/// A pose from position [m] and quaternion (w, x, y, z) of any length but zero.
inline Pose<double> checked_pose(const Vector3<double>& position, const Vector4<double>& quaternion) {
  require_finite("position", position);
  require_finite("quaternion", quaternion);
  const double norm = quaternion.stableNorm();
  if (!(norm > 0.0)) throw std::invalid_argument("quaternion: expected one that is not zero, got zero");
  return {position, quaternion / norm};
}

/// Weights of the six systems as a (6, 7, 7) array, row: term of u, column: term of u-dot.
/// @param weights FuzzyWeights, or NoState of a law without weights: zeros
template <class Weights>
py::array_t<double> weight_array(const Weights& weights) {
  py::array_t<double> out({kAxes, kTerms, kTerms});
  detail::write_weights(weights, 0, out.mutable_data());
  return out;
}

}  // namespace hexservo::bindings
