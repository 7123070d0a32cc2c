// hexservo's own side of the comparisons with fuzzylite and ViSP: the core's functions, timed in the same way.
//
// kernels fuzzy: parameters 49 weights, row by row (row: term of u); row: six pairs (u, u-dot); answer: 6 outputs.
//
// kernels jacobian: parameter f; row: 4 x (x, y, Z), desired features (8); answer: J at R = I, row by row, then xi~.
//
// kernels tick: parameters desired features (8), then those seen from home (8); row: features (8), depth (4), position
// (3), quaternion (4), twist (6); answer: wrench (6).
#include "hexservo/controller.hpp"

#include "../serve.hpp"

namespace {

using namespace hexservo;

const auto stateless = [] {};

template <int N>
Vector<double, N> vector_at(const double* numbers) {
  return Eigen::Map<const Vector<double, N>>(numbers);
}

int fuzzy() {
  const std::vector<double> table = peers::read_numbers(kTerms * kTerms);
  const FuzzyGains<double> gains;
  FuzzyGains<double> start = gains;
  start.initial_scale.setOnes();
  for (int row = 0; row < kTerms; ++row)
    for (int column = 0; column < kTerms; ++column)
      start.table(row, column) = table[static_cast<std::size_t>(row * kTerms + column)];
  const FuzzyWeights<double> weights = initial_weights(start);
  const Bells<double> bells(gains.bell_width, gains.bell_slope);
  return peers::serve("hexservo", 12, kAxes, stateless, [&](const double* row, double* out) {
    Vector6<double> u, u_rate;
    for (int j = 0; j < kAxes; ++j) {
      u(j) = row[2 * j];
      u_rate(j) = row[2 * j + 1];
    }
    FuzzyBasis<double> basis;
    AxisVector<double> share, output;
    fire<double>(bells, FuzzyStage<double>{&weights}, u, u_rate, basis, share, output);
    Eigen::Map<Vector6<double>>{out} = output.vector();
  });
}

int jacobian() {
  const double focal = peers::read_numbers(1)[0];
  const Vector3<double> p_BE = Vector3<double>::Zero();
  const Matrix3<double> R_BE = Matrix3<double>::Identity();
  return peers::serve("hexservo", 20, 56, stateless, [&](const double* row, double* out) {
    Image<double> image;
    for (int i = 0; i < kPoints; ++i) {
      image.features(2 * i) = row[3 * i];
      image.features(2 * i + 1) = row[3 * i + 1];
      image.depth(i) = row[3 * i + 2];
    }
    const ImageJacobian<double> J(focal, -1.0, image, p_BE, R_BE);
    Eigen::Map<Eigen::Matrix<double, 8, 6, Eigen::RowMajor>>{out} = J.matrix();
    Eigen::Map<Vector<double, 8>>{out + 48} = vector_at<8>(row + 12) - image.features;
  });
}

int tick() {
  const std::vector<double> features = peers::read_numbers(16);
  Settings settings;
  settings.target.desired_features = vector_at<8>(features.data());
  settings.target.initial_features = vector_at<8>(features.data() + 8);
  const ControllerGains<Hybrid> gains = controller_gains<Hybrid>(settings, 1e-3);
  ControllerState<Hybrid> state = initial_state(gains);
  const auto restart = [&] { state = initial_state(gains); };
  return peers::serve("hexservo", 25, 6, restart, [&](const double* row, double* out) {
    const ControllerInput input = input_of(0.0, {{vector_at<8>(row), vector_at<4>(row + 8)},
                                                 {vector_at<3>(row + 12), vector_at<4>(row + 15)},
                                                 vector_at<6>(row + 19)});
    Eigen::Map<Vector6<double>>{out} = step(gains, state, input).wrench;
  });
}

}  // namespace

int main(int count, char** arguments) {
  const std::string kernel = count == 2 ? arguments[1] : "";
  if (kernel == "fuzzy") return fuzzy();
  if (kernel == "jacobian") return jacobian();
  if (kernel == "tick") return tick();
  std::cerr << "kernel: expected fuzzy, jacobian or tick, got " << (kernel.empty() ? "none" : kernel) << '\n';
  return 2;
}
