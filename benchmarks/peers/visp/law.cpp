// The image-based law of ViSP for four points, as a separate program: nothing of hexservo is linked with it.
//
//   law jacobian   interaction matrix of the four points and feature error; answer: L (8 x 6) row by row, s - s* (8)
//   law velocity   `vpServo::computeControlLaw`, v = -lambda pinv(L) (s - s*); answer: v (6)
//
// Features are normalised coordinates x = X/Z, y = Y/Z in a camera that looks along +z; points do not move.
// The task is built once; setting the four measured points and the evaluation are timed.
//
// parameters: lambda, 4 x (x, y) desired; row: 4 x (x, y, Z)
#include <visp3/visual_features/vpFeaturePoint.h>
#include <visp3/vs/vpServo.h>

#include "../serve.hpp"

int main(int count, char** arguments) {
  const std::string answer = count == 2 ? arguments[1] : "";
  if (answer != "jacobian" && answer != "velocity") {
    std::cerr << "answer: expected jacobian or velocity, got " << (answer.empty() ? "none" : answer) << '\n';
    return 2;
  }
  const std::vector<double> parameters = peers::read_numbers(9);
  vpFeaturePoint seen[4], desired[4];
  vpServo task;
  task.setServo(vpServo::EYEINHAND_CAMERA);
  task.setInteractionMatrixType(vpServo::CURRENT, vpServo::PSEUDO_INVERSE);
  task.setLambda(parameters[0]);
  for (std::size_t i = 0; i < 4; ++i) {
    seen[i].buildFrom(0.0, 0.0, 1.0);
    desired[i].buildFrom(parameters[1 + 2 * i], parameters[2 + 2 * i], 1.0);
    task.addFeature(seen[i], desired[i]);
  }
  const auto look = [&](const double* row) {
    for (std::size_t i = 0; i < 4; ++i) seen[i].set_xyZ(row[3 * i], row[3 * i + 1], row[3 * i + 2]);
  };

  const std::string version = "ViSP " + std::to_string(VISP_VERSION_MAJOR) + "." + std::to_string(VISP_VERSION_MINOR) +
                              "." + std::to_string(VISP_VERSION_PATCH);
  int status = 0;
  if (answer == "jacobian") {
    status = peers::serve(
        version, 12, 56, [] {},
        [&](const double* row, double* out) {
          look(row);
          const vpMatrix L = task.computeInteractionMatrix();
          const vpColVector error = task.computeError();
          std::copy_n(L.data, 48, out);
          std::copy_n(error.data, 8, out + 48);
        });
  } else {
    status = peers::serve(
        version, 12, 6, [] {},
        [&](const double* row, double* out) {
          look(row);
          const vpColVector v = task.computeControlLaw();
          std::copy_n(v.data, 6, out);
        });
  }
  task.kill();
  return status;
}
