// Projection (4), image Jacobian (5)-(8), measured Jacobian and its error (9)-(12), both sign conventions.
#include "hexservo/camera.hpp"
#include "hexservo/rigid_body.hpp"

#include "compare.hpp"
#include "decompositions.hpp"
#include "random.hpp"

#include <type_traits>

using namespace hexservo;
using namespace hexservo::test;

namespace {

using Features = Vector<double, 8>;
using Depths = Vector<double, 4>;
using Points = Eigen::Matrix<double, 3, 4>;
using Jacobian = Eigen::Matrix<double, 8, 6>;

constexpr double kFocal = 72727.0 * 0.008;  // [px]

/// A camera pose and four points in front of it.
struct View {
  Vector3<double> p_BE;
  Matrix3<double> R_BE;
  Points points_B;
  Image<double> image() const { return take_image(kFocal, p_BE, R_BE, points_B); }
};

View random_view(Random& random) {
  View view{random.matrix<3>(0.2), random.rotation(), Points{}};
  for (int i = 0; i < 4; ++i) {
    const double depth = random.uniform(0.2, 1.0);
    const Vector3<double> p_E(random.uniform(-0.3, 0.3) * depth, random.uniform(-0.3, 0.3) * depth, -depth);
    view.points_B.col(i) = view.p_BE + view.R_BE * p_E;
  }
  return view;
}

View moved(const View& view, const Vector6<double>& twist, double time) {
  const Vector3<double> omega = twist.tail<3>();
  const Matrix3<double> turn = Eigen::AngleAxisd(omega.norm() * time, omega.normalized()).toRotationMatrix();
  return {view.p_BE + twist.head<3>() * time, turn * view.R_BE, view.points_B};
}

/// (8), entry by entry as the paper prints it.
Eigen::Matrix<double, 2, 6> printed_jacobian(double f, double x, double y, double Z) {
  Eigen::Matrix<double, 2, 6> J;
  J << -f / Z, 0.0, -x / Z, x * y / f, -(f * f + x * x) / f, -y,  //
      0.0, -f / Z, -y / Z, (f * f + y * y) / f, -x * y / f, x;
  return J;
}

/// (8) of four points times K(chi) = blkdiag(R^T, R^T).
Jacobian printed_jacobian(const Image<double>& image, const Matrix3<double>& R_BE) {
  Matrix6<double> K = Matrix6<double>::Zero();
  K.topLeftCorner<3, 3>() = R_BE.transpose();
  K.bottomRightCorner<3, 3>() = R_BE.transpose();
  Jacobian J;
  for (int i = 0; i < 4; ++i)
    J.middleRows<2>(2 * i) =
        printed_jacobian(kFocal, image.features(2 * i), image.features(2 * i + 1), image.depth(i)) * K;
  return J;
}

const Vector3<double> kAnywhere(0.1, -0.2, 0.3);  // the position does not matter to a camera on the platform

ImageJacobian<double> jacobian(double sign, const Image<double>& image, const Matrix3<double>& R_BE) {
  return ImageJacobian<double>(kFocal, sign, image, kAnywhere, R_BE);
}

const Features kStart = (Features() << 30, 18, 65, -65, -44, 37, -10, -15).finished();
const Features kGoal = (Features() << 10, 10, 45, -73, -64, 29, -30, -23).finished();

double condition_number(const Features& features, double depth) {
  const Image<double> image{features, Depths::Constant(depth)};
  const Eigen::MatrixXd J = jacobian(-1.0, image, Matrix3<double>::Identity()).matrix();
  const Eigen::VectorXd sigma = singular_values(J);
  return sigma(0) / sigma(5);
}

}  // namespace

// A Jacobian refers to its image and attitude: temporaries, which would be gone before it is used, do not compile.
static_assert(std::is_constructible_v<ImageJacobian<double>, double, double, const Image<double>&,
                                      const Vector3<double>&, const Matrix3<double>&>);
static_assert(!std::is_constructible_v<ImageJacobian<double>, double, double, Image<double>, const Vector3<double>&,
                                       const Matrix3<double>&>);
static_assert(!std::is_constructible_v<ImageJacobian<double>, double, double, const Image<double>&,
                                       const Vector3<double>&, Matrix3<double>>);
static_assert(!std::is_constructible_v<ImageJacobian<double>, double, double, const Image<double>&, Vector3<double>,
                                       const Matrix3<double>&>);

TEST_CASE("projection (4) and back projection are inverses, both ways") {
  Random random(7501);
  CAPTURE(random.seed());
  for (int trial = 0; trial < 200; ++trial) {
    const Vector3<double> p_E(random.uniform(-1.0, 1.0), random.uniform(-1.0, 1.0), random.uniform(-2.0, -0.1));
    const Vector2<double> feature = project(kFocal, p_E);
    CHECK(feature(0) == doctest::Approx(-kFocal * p_E(0) / p_E(2)).epsilon(4.0 * kEpsilon));
    CHECK(feature(1) == doctest::Approx(-kFocal * p_E(1) / p_E(2)).epsilon(4.0 * kEpsilon));
    CHECK(distance(back_project(kFocal, feature, p_E(2)), p_E) <= 8.0 * kEpsilon * p_E.norm());
    const Vector2<double> pixel = random.matrix<2>(300.0);
    const double depth = random.uniform(-2.0, -0.1);
    CHECK(distance(project(kFocal, back_project(kFocal, pixel, depth)), pixel) <= 8.0 * kEpsilon * 300.0);
  }
  CHECK(Camera{}.focal() == doctest::Approx(581.816).epsilon(4.0 * kEpsilon));
}

TEST_CASE("an image is the projection of P = R^T (P_B - x_p), with its depth") {
  Random random(7502);
  CAPTURE(random.seed());
  for (int trial = 0; trial < 50; ++trial) {
    const View view = random_view(random);
    const Image<double> image = view.image();
    for (int i = 0; i < 4; ++i) {
      const Vector3<double> p_E = view.R_BE.transpose() * (view.points_B.col(i) - view.p_BE);
      CHECK(image.depth(i) == doctest::Approx(p_E(2)).epsilon(1e-14));
      CHECK(image.depth(i) < 0.0);
      CHECK(distance(image.features.segment<2>(2 * i), project(kFocal, p_E)) <= 1e-11);
      // lifting the pixel again finds the point in B
      const Vector3<double> lifted = back_project<double>(kFocal, image.features.segment<2>(2 * i), image.depth(i));
      CHECK(distance(view.p_BE + view.R_BE * lifted, view.points_B.col(i)) <= 1e-14);
    }
  }
}

TEST_CASE("the image Jacobian of real points is minus (8): central differences of the image along random twists") {
  Random random(7503);
  CAPTURE(random.seed());
  for (int trial = 0; trial < 300; ++trial) {
    CAPTURE(trial);
    const View view = random_view(random);
    const Vector6<double> twist = random.six(0.1, 0.5);
    // Image rates are of order f (v/Z + omega); every further derivative brings a factor (v/Z + omega) < 2/s, so that
    // h = 1e-5 s is off by (2 h)^2 ~ 4e-10 relative, and rounding adds eps 200 px/h = 4e-9 px/s of some 100 px/s.
    const double h = 1e-5;
    const Features difference =
        (moved(view, twist, h).image().features - moved(view, twist, -h).image().features) / (2.0 * h);
    CHECK(relative_distance(jacobian(-1.0, view.image(), view.R_BE).push(twist), difference) <= 1e-7);
    CHECK(relative_distance(-printed_jacobian(view.image(), view.R_BE) * twist, difference) <= 1e-7);
    // which is erratum 1: (8) as printed has the opposite sign
    CHECK(relative_distance(jacobian(1.0, view.image(), view.R_BE).push(twist), difference) > 1.0);
  }
}

TEST_CASE("matrix, push and pull are one matrix: (8) as printed, entry by entry, times blkdiag(R^T, R^T)") {
  Random random(7504);
  CAPTURE(random.seed());
  for (int trial = 0; trial < 200; ++trial) {
    CAPTURE(trial);
    const View view = random_view(random);
    const Image<double> image = view.image();
    for (const double sign : {1.0, -1.0}) {
      const Jacobian literal = sign * printed_jacobian(image, view.R_BE);
      const ImageJacobian<double> J = jacobian(sign, image, view.R_BE);
      CHECK(relative_distance(J.matrix(), literal) <= 20.0 * kEpsilon);
      const Vector6<double> twist = random.six(0.1, 0.5);
      const Features force = random.matrix<8>();
      CHECK(distance(J.push(twist), literal * twist) <=
            50.0 * kEpsilon * (literal.cwiseAbs() * twist.cwiseAbs()).maxCoeff());
      CHECK(distance(J.pull(force).vector(), literal.transpose() * force) <=
            50.0 * kEpsilon * (literal.transpose().cwiseAbs() * force.cwiseAbs()).maxCoeff());
      // adjoint: force . (J twist) = (J^T force) . twist
      CHECK(std::abs(force.dot(J.push(twist)) - J.pull(force).vector().dot(twist)) <=
            100.0 * kEpsilon * force.cwiseAbs().dot(literal.cwiseAbs() * twist.cwiseAbs()));
    }
    // without rotation the matrix is (8) itself
    const Jacobian upright = jacobian(1.0, image, Matrix3<double>::Identity()).matrix();
    for (int i = 0; i < 4; ++i) {
      const auto expected = printed_jacobian(kFocal, image.features(2 * i), image.features(2 * i + 1), image.depth(i));
      CHECK(relative_distance(upright.middleRows<2>(2 * i), expected) <= 4.0 * kEpsilon);
    }
  }
}

TEST_CASE("measured Jacobian (9), (10), (12): J_m = J + Delta J, and only its translational columns are wrong") {
  Random random(7505);
  CAPTURE(random.seed());
  for (int trial = 0; trial < 100; ++trial) {
    CAPTURE(trial);
    const View view = random_view(random);
    const Image<double> image = view.image();
    const Depths error = random.matrix<4>(0.3);
    const Image<double> measured = measured_image(image, error);
    CHECK(measured.features == image.features);
    for (int i = 0; i < 4; ++i)
      CHECK(measured.depth(i) == doctest::Approx((1.0 + error(i)) * image.depth(i)).epsilon(4.0 * kEpsilon));
    for (const double sign : {1.0, -1.0}) {
      const Jacobian J = jacobian(sign, image, view.R_BE).matrix(), J_m = jacobian(sign, measured, view.R_BE).matrix();
      const Jacobian delta = image_jacobian_error(kFocal, sign, image, error, view.p_BE, view.R_BE);
      CHECK(relative_distance(J + delta, J_m) <= 4.0 * kEpsilon);
      CHECK(relative_distance(J_m, sign * printed_jacobian(measured, view.R_BE)) <= 20.0 * kEpsilon);
      // (8) has the depth in its first three columns alone, as 1/Z: there Delta J = (1/(1 + delta) - 1) J
      CHECK(delta.rightCols<3>().cwiseAbs().maxCoeff() <= 20.0 * kEpsilon * J.cwiseAbs().maxCoeff());
      for (int i = 0; i < 4; ++i) {
        const Eigen::Matrix<double, 2, 3> expected = (1.0 / (1.0 + error(i)) - 1.0) * J.block<2, 3>(2 * i, 0);
        CHECK(distance(delta.block<2, 3>(2 * i, 0), expected) <= 20.0 * kEpsilon * J.cwiseAbs().maxCoeff());
      }
      CHECK(image_jacobian_error<double, 4>(kFocal, sign, image, Depths::Zero(), view.p_BE, view.R_BE).isZero(0.0));
    }
  }
}

TEST_CASE("the printed depth rate is the third row of (6), and minus the depth rate of a moving camera") {
  Random random(7506);
  CAPTURE(random.seed());
  for (int trial = 0; trial < 200; ++trial) {
    CAPTURE(trial);
    const View view = random_view(random);
    const Image<double> image = view.image();
    const Vector6<double> twist = random.six(0.1, 0.5);
    const Depths rate = printed_depth_rate(kFocal, image, view.R_BE, twist);
    for (int i = 0; i < 4; ++i) {
      // (6): [1, -[p]x] blkdiag(R^T, R^T) chi-dot
      const Vector3<double> p_E = view.R_BE.transpose() * (view.points_B.col(i) - view.p_BE);
      Eigen::Matrix<double, 3, 6> map;
      map << Matrix3<double>::Identity(), -skew(p_E);
      Vector6<double> twist_E;
      twist_E << view.R_BE.transpose() * twist.head<3>(), view.R_BE.transpose() * twist.tail<3>();
      CHECK(std::abs(rate(i) - (map * twist_E)(2)) <= 1e-14);
    }
    const double h = 1e-5;
    const Depths physical = (moved(view, twist, h).image().depth - moved(view, twist, -h).image().depth) / (2.0 * h);
    CHECK(distance(-rate, physical) <= 1e-9);
  }
}

TEST_CASE("(12) and (6) as printed belong together: they move the point that (5) differentiates") {
  // xi and Z of a point that moves by (6) in E: the chain rule through (4) must give (12).
  Random random(7507);
  CAPTURE(random.seed());
  for (int trial = 0; trial < 100; ++trial) {
    CAPTURE(trial);
    const View view = random_view(random);
    const Image<double> image = view.image();
    const Vector6<double> twist = random.six(0.1, 0.5);
    const Vector3<double> v_E = view.R_BE.transpose() * twist.head<3>(), w_E = view.R_BE.transpose() * twist.tail<3>();
    const Features rate = jacobian(1.0, image, view.R_BE).push(twist);
    for (int i = 0; i < 4; ++i) {
      const Vector3<double> p_E = back_project<double>(kFocal, image.features.segment<2>(2 * i), image.depth(i));
      const Vector3<double> p_rate = w_E.cross(p_E) + v_E;
      const double h = 1e-5;
      const Vector2<double> difference =
          (project<double>(kFocal, p_E + h * p_rate) - project<double>(kFocal, p_E - h * p_rate)) / (2.0 * h);
      CHECK(distance(rate.segment<2>(2 * i), difference) <= 1e-7 * rate.norm());
    }
  }
}

TEST_CASE("signs of plant and controller for all four combinations") {
  using enum CameraConvention;
  using enum JacobianConvention;
  static_assert(plant_sign(eye_in_hand) == -1.0 && plant_sign(as_printed) == 1.0);
  static_assert(controller_sign(eye_in_hand, consistent) == -1.0);
  static_assert(controller_sign(as_printed, consistent) == 1.0);
  static_assert(controller_sign(as_printed, printed) == 1.0);
  static_assert(controller_sign(eye_in_hand, printed) == 1.0, "erratum 1: positive feedback over a real projection");
  CHECK(true);
}

TEST_CASE("the paper's goal is one parallel shift of (-20, -8) px, which a pure translation of the camera makes") {
  for (int i = 0; i < 4; ++i) CHECK((kGoal - kStart).segment<2>(2 * i) == Vector2<double>(-20.0, -8.0));
  const double depth = 0.5;
  Points points_B;
  for (int i = 0; i < 4; ++i) points_B.col(i) = back_project<double>(kFocal, kStart.segment<2>(2 * i), -depth);
  const Vector3<double> shift(20.0 * depth / kFocal, 8.0 * depth / kFocal, 0.0);
  CHECK(distance(shift, Vector3<double>(17.188e-3, 6.875e-3, 0.0)) <= 0.5e-6);  // docs/model.md, section 4
  const Image<double> image = take_image<double, 4>(kFocal, shift, Matrix3<double>::Identity(), points_B);
  CHECK(distance(image.features, kGoal) <= 1e-12);
}

TEST_CASE("the paper's test case is badly conditioned: 1760 at the start, 3170 at the translated goal") {
  CHECK(std::abs(condition_number(kStart, -0.5) - 1760.0) <= 5.0);  // half a unit of the third digit
  CHECK(std::abs(condition_number(kGoal, -0.5) - 3170.0) <= 5.0);
}

TEST_CASE("NaN goes through the camera") {
  Random random(7508);
  CAPTURE(random.seed());
  const View view = random_view(random);
  View broken = view;
  broken.points_B(0, 2) = kNaN;
  CHECK(std::isnan(broken.image().features(4)));
  Image<double> image = view.image();
  image.depth(1) = kNaN;
  const ImageJacobian<double> J = jacobian(-1.0, image, view.R_BE);
  CHECK(J.push(random.six(0.1, 0.5)).hasNaN());
  CHECK(J.pull(Features(random.matrix<8>())).vector().hasNaN());
}
