// A camera on a mount, on the platform or on the base: projection, image Jacobian, pose estimate and goal through C in
// E or B (docs/model.md, section 4).
#include "hexservo/settings.hpp"

#include "compare.hpp"
#include "random.hpp"

#include <array>
#include <numbers>

using namespace hexservo;
using namespace hexservo::test;

namespace {

using Features = Vector<double, 8>;
using Points = Eigen::Matrix<double, 3, 4>;
using Transform = Eigen::Isometry3d;

constexpr double kFocal = 581.816;
const Vector6<double> kImageAlone = Vector6<double>::Zero();

Transform transform(const Vector3<double>& position, const Matrix3<double>& rotation) {
  Transform X = Transform::Identity();
  X.translate(position).rotate(rotation);
  return X;
}

Transform pose_of(const Pose<double>& pose) {
  const Vector4<double> q = pose.quaternion.normalized();
  return transform(pose.position, Eigen::Quaterniond(q(0), q(1), q(2), q(3)).toRotationMatrix());
}

/// What a mount is on, and the axes of its camera.
struct Kind {
  MountedOn on;
  CameraAxes axes;
};
constexpr std::array kKinds = {Kind{MountedOn::platform, CameraAxes::paper},
                               Kind{MountedOn::platform, CameraAxes::opencv}, Kind{MountedOn::base, CameraAxes::paper},
                               Kind{MountedOn::base, CameraAxes::opencv}};

/// A mounted camera, and by Eigen the transform of C in the frame M of its mount.
struct Mounted {
  explicit Mounted(const Mount& mount, Kind which = kKinds[0])
      : kind(which),
        camera(prepared(mount, which)),
        X_MC(transform(mount.position,
                       Eigen::AngleAxisd(mount.rotation.norm(), mount.rotation.normalized()).toRotationMatrix())) {}

  static CameraParameters<double> prepared(const Mount& mount, Kind kind) {
    Camera camera;
    camera.focal_pixels = Vector2<double>(kFocal, kFocal);
    camera.axes = kind.axes;
    camera.mount = {mount, kind.on};
    return camera.parameters();
  }

  bool on_base() const { return kind.on == MountedOn::base; }
  /// C in the frame that the points are fixed in: B, or E of a camera on the base.
  Transform X_TC(const Pose<double>& pose) const {
    return on_base() ? Transform(pose_of(pose).inverse() * X_MC) : Transform(pose_of(pose) * X_MC);
  }
  /// 1 for axes that look along +z.
  double ahead() const { return kind.axes == CameraAxes::opencv ? 1.0 : -1.0; }

  /// (4) with the inverse of a product of transforms, without the core.
  Features image(const Pose<double>& pose, const Points& points) const {
    Features features;
    for (int i = 0; i < 4; ++i) {
      const Vector3<double> p_C = X_TC(pose).inverse() * points.col(i).eval();
      features.segment<2>(2 * i) = kFocal * Vector2<double>(p_C(0), -ahead() * p_C(1)) / std::abs(p_C(2));
    }
    return features;
  }

  Kind kind;
  PlatformCamera<double> camera;
  Transform X_MC;
};

Mounted random_mount(Random& random, Kind kind, double metres = 0.1, double radians = 3.0) {
  Vector3<double> turn = random.matrix<3>();
  turn *= radians / turn.norm();
  return Mounted({random.matrix<3>(metres), turn}, kind);
}

Pose<double> random_pose(Random& random) {
  const Eigen::Quaterniond q(random.rotation());
  return {random.matrix<3>(0.2), Vector4<double>(q.w(), q.x(), q.y(), q.z())};
}

/// Like a square in front of the camera, each corner off its place and its plane.
Points points_before(Random& random, const Mounted& mounted, const Pose<double>& pose, double flat = 1.0) {
  Points points;
  for (int i = 0; i < 4; ++i) {
    const Vector3<double> off = random.matrix<3>(0.04);
    const Vector3<double> p_C(i < 2 ? 0.08 : -0.08, i % 2 == 0 ? 0.08 : -0.08, 0.5 * mounted.ahead());
    points.col(i) = mounted.X_TC(pose) * Vector3<double>(p_C + Vector3<double>(off(0), off(1), flat * off(2)));
  }
  return points;
}

/// Moved, and turned about E's origin by a rotation vector in B.
Pose<double> shifted(const Pose<double>& pose, const Vector6<double>& d) {
  const Vector3<double> turn = d.tail<3>();
  const Eigen::Quaterniond q(Eigen::AngleAxisd(turn.norm(), turn.stableNormalized()) * pose_of(pose).rotation());
  return {pose.position + d.head<3>(), Vector4<double>(q.w(), q.x(), q.y(), q.z())};
}

double far_from(const Pose<double>& a, const Pose<double>& b) { return pose_difference(a, b).norm(); }

}  // namespace

TEST_CASE("the image through a mount is that of the product of both transforms, and lifting is its inverse") {
  Random random(14101);
  CAPTURE(random.seed());
  for (int trial = 0; trial < 200; ++trial) {
    CAPTURE(trial);
    const Mounted mounted = random_mount(random, kKinds[static_cast<std::size_t>(trial) % kKinds.size()]);
    const Pose<double> pose = random_pose(random);
    const Points points = points_before(random, mounted, pose);
    const Matrix3<double> R_BE = rotation_matrix(pose.quaternion);
    const Image<double> image = take_image<double, 4>(mounted.camera, pose.position, R_BE, points);
    // lengths of up to 1 m, of which coordinates beside the axis are 1e2 px per depth
    CHECK(distance(image.features, mounted.image(pose, points)) <= 1e-10);
    for (int i = 0; i < 4; ++i) {
      const Vector3<double> p_T =
          lift<double>(mounted.camera, pose.position, R_BE, image.features.segment<2>(2 * i), image.depth(i));
      CHECK(distance(p_T, Vector3<double>(points.col(i))) <= 1e-14);
    }
  }
}

TEST_CASE("the image Jacobian through a mount is the derivative of the image along motions of the platform") {
  Random random(14102);
  CAPTURE(random.seed());
  const double h = 1e-5;  // third derivatives of some 1e4 px h^2, and rounding of 1e-12 px / h
  for (int trial = 0; trial < 200; ++trial) {
    CAPTURE(trial);
    const Mounted mounted = random_mount(random, kKinds[static_cast<std::size_t>(trial) % kKinds.size()]);
    const Pose<double> pose = random_pose(random);
    const Points points = points_before(random, mounted, pose);
    const Matrix3<double> R_BE = rotation_matrix(pose.quaternion);
    const Image<double> image = take_image<double, 4>(mounted.camera, pose.position, R_BE, points);
    const ImageJacobian<double> J(mounted.camera, -1.0, image, pose.position, R_BE);
    const Eigen::Matrix<double, 8, 6> matrix = J.matrix();
    for (int j = 0; j < 6; ++j) {
      const Vector6<double> d = h * Vector6<double>::Unit(j);
      const Features slope =
          (mounted.image(shifted(pose, d), points) - mounted.image(shifted(pose, -d), points)) / (2.0 * h);
      CHECK(distance(Features(matrix.col(j)), slope) <= 1e-8 * matrix.cwiseAbs().maxCoeff());
    }
    const Vector6<double> twist = random.six(0.1, 0.5);
    const Features force = random.matrix<8>();
    const double most = matrix.cwiseAbs().maxCoeff();
    CHECK(distance(J.push(twist), Features(matrix * twist)) <= 1e-14 * most);
    CHECK(distance(J.pull(force).vector(), Vector6<double>(matrix.transpose() * force)) <= 1e-13 * most);
    const Matrix6<double> normal = whole(J.normal_matrix());
    CHECK(relative_distance(normal, Matrix6<double>(matrix.transpose() * matrix)) <= 1e-14);
  }
}

TEST_CASE("a mount that is none changes no number, also where other lanes have one") {
  Random random(14103);
  CAPTURE(random.seed());
  PlatformCamera<double> none(kFocal);
  CHECK_FALSE(PlatformCamera<double>(Mounted::prepared({}, kKinds[0])).mounted);
  none.mounted = true;
  for (int trial = 0; trial < 100; ++trial) {
    CAPTURE(trial);
    const Pose<double> pose = random_pose(random);
    const Matrix3<double> R_BE = rotation_matrix(pose.quaternion);
    const Points points = points_before(random, Mounted(Mount{}), pose);
    const Image<double> image = take_image<double, 4>(kFocal, pose.position, R_BE, points);
    const Image<double> same = take_image<double, 4>(none, pose.position, R_BE, points);
    CHECK(image.features == same.features);
    CHECK(image.depth == same.depth);
    const ImageJacobian<double> J(kFocal, -1.0, image, pose.position, R_BE), K(none, -1.0, image, pose.position, R_BE);
    const Vector6<double> twist = random.six(0.1, 0.5);
    const Features force = random.matrix<8>();
    CHECK(J.push(twist) == K.push(twist));
    CHECK(J.pull(force).vector() == K.pull(force).vector());
    CHECK(J.matrix() == K.matrix());
  }
}

TEST_CASE("through a mount the curvature of the features is their second derivative") {
  Random random(14104);
  CAPTURE(random.seed());
  const double h = 1e-4;  // fourth derivatives of 1e5 px h^2, and rounding of 1e-13 px / h^2
  const PosePrior<double> none{{}, kImageAlone};
  for (int trial = 0; trial < 50; ++trial) {
    CAPTURE(trial);
    const Mounted mounted = random_mount(random, kKinds[static_cast<std::size_t>(trial) % kKinds.size()]);
    const Pose<double> pose = random_pose(random);
    const Points points = points_before(random, mounted, pose);
    const Features weights = random.matrix<8>(1.0);
    const auto weighted = [&](const Vector6<double>& d) {
      return weights.dot(mounted.image(shifted(pose, d), points));
    };
    const auto fit = pose_fit<double, 4>(mounted.camera, Vectors3<double, 4>(points), Features::Zero(), none, pose);
    const Matrix6<double> curvature = feature_curvature<double, 4>(mounted.camera, fit, weights);
    for (int i = 0; i < 6; ++i)
      for (int j = 0; j <= i; ++j) {
        const Vector6<double> u = h * Vector6<double>::Unit(i), v = h * Vector6<double>::Unit(j);
        const double difference =
            (weighted(u + v) - weighted(u - v) - weighted(v - u) + weighted(-u - v)) / (4.0 * h * h);
        CHECK(std::abs(curvature(i, j) - difference) <= 1e-4 * (1.0 + curvature.cwiseAbs().maxCoeff()));
      }
  }
}

TEST_CASE(
    "a pose and a goal are found through a mount, and a planar target's other pose is mirrored about its camera") {
  Random random(14105);
  CAPTURE(random.seed());
  for (int trial = 0; trial < 100; ++trial) {
    CAPTURE(trial);
    const Mounted mounted = random_mount(random, kKinds[static_cast<std::size_t>(trial) % kKinds.size()]);
    const Pose<double> truth = random_pose(random);
    const Points points = points_before(random, mounted, truth);
    const Features seen = mounted.image(truth, points);
    const Pose<double> start = shifted(truth, random.six(0.02, 0.05));
    const PoseEstimate<double> found = estimate_pose<double, 4>(mounted.camera, points, seen, start, kImageAlone);
    CHECK_FALSE(found.failed);
    CHECK(far_from(found.pose, truth) <= 1e-8);  // 1e-11 px over the smallest singular values, of some 10 px
    CHECK(far_from(goal_pose(mounted.camera, points, seen, start), truth) <= 1e-8);

    // the mirror image of a mirror image is the pose, and the camera stays as far from the centroid
    const Points flat = points_before(random, mounted, truth, 0.0);
    const Pose<double> mirrored = mirrored_pose<double, 4>(mounted.camera, flat, truth);
    CHECK(far_from(mirrored_pose<double, 4>(mounted.camera, flat, mirrored), truth) <= 1e-7);
    const Vector3<double> centroid = flat.rowwise().mean();
    CHECK((mounted.X_TC(mirrored).translation() - centroid).norm() ==
          doctest::Approx((mounted.X_TC(truth).translation() - centroid).norm()));
    // To first order in size over distance the image is the same: a target a hundredth as large, to 1e-2 of its size.
    const Points small = centroid.replicate<1, 4>() + 0.01 * (flat.colwise() - centroid);
    const Features here = mounted.image(truth, small);
    const double size = (here - here.head<2>().replicate<4, 1>()).norm();
    const Pose<double> other = mirrored_pose<double, 4>(mounted.camera, small, truth);
    CHECK((mounted.image(other, small) - here).norm() <= 0.03 * size);
  }
}

TEST_CASE("refused: rotations beyond pi, a mount of a camera as printed, and a target behind the mounted camera") {
  const auto refusal_of = [](auto&& change) {
    auto settings = Settings::of<Hybrid>();
    settings.target.initial_features << 30, 18, 65, -65, -44, 37, -10, -15;
    settings.target.desired_features << 10, 10, 45, -73, -64, 29, -30, -23;
    change(settings);
    return refusal([&] { loop_parameters<Hybrid>(settings); });
  };
  CHECK(refusal_of([](Settings& s) { s.camera.mount.rotation = {0.0, 0.0, 90.0}; }) ==
        "camera.mount.rotation: expected a rotation vector at most 3.14159 rad long, got one of 90 rad "
        "(degrees?)");
  CHECK(is_about(refusal_of([](Settings& s) { s.uncertainty.mount.rotation = {0.0, -4.0, 0.0}; }),
                 "uncertainty.mount.rotation"));
  CHECK(is_about(refusal_of([](Settings& s) {
                   s.camera.convention = CameraConvention::as_printed;
                   s.camera.mount.position = {0.01, 0.0, 0.0};
                 }),
                 "camera.mount"));
  CHECK(is_about(refusal_of([](Settings& s) {
                   s.camera.convention = CameraConvention::as_printed;
                   s.camera.mount.on = MountedOn::base;
                 }),
                 "camera.mount"));
  const auto points =
      (Eigen::Matrix<double, 4, 3>() << 0.1, 0.1, -0.6, 0.1, -0.1, -0.6, -0.1, -0.1, -0.6, -0.1, 0.1, -0.65).finished();
  CHECK(refusal_of([&](Settings& s) { s.target.points = points; }) == "(accepted)");
  for (const Mount& mount : {Mount{{0.0, 0.0, -0.5}, {0.0, 0.0, 0.0}}, Mount{{0.0, 0.0, 0.0}, {3.0, 0.0, 0.0}}}) {
    const std::string message = refusal_of([&](Settings& s) {
      s.target.points = points;
      s.camera.mount = {mount, MountedOn::platform};
    });
    CHECK(is_about(message, "target.points[0]"));
    CHECK(message.find("camera.mount") != std::string::npos);
  }
  // what is assumed: position in E, rotation in C
  const Mount mount{{0.01, 0.02, 0.03}, {0.0, 0.0, std::numbers::pi / 2}}, error{{1e-3, 0.0, 0.0}, {0.2, 0.0, 0.0}};
  const CameraMount on_base = assumed_mount({mount, MountedOn::base}, error);
  CHECK(on_base.on == MountedOn::base);
  const Placement<double> assumed = placement(on_base, "");
  CHECK(distance(assumed.p_MC, Vector3<double>(0.011, 0.02, 0.03)) <= 1e-17);
  const Matrix3<double> about_x = Eigen::AngleAxisd(0.2, Vector3<double>::UnitX()).toRotationMatrix();
  CHECK(distance(assumed.R_MC, Matrix3<double>(placement(mount, "").R_MC * about_x)) <= 1e-15);
}
