/// @file
/// The camera: projection (4), image Jacobian (5)-(8), measured Jacobian and its error (9)-(12), both sign conventions.
///
/// | paper            | here                          |                                                           |
/// | ---------------- | ----------------------------- | --------------------------------------------------------- |
/// | alpha, lambda    | pixel_scale, focal_length     | [px/m], [m]; f = alpha lambda [px]                        |
/// | xi, Z            | features, depth               | (x1, y1, ...) [px]; Z_i < 0 in front of the camera [m]    |
/// | J_im             | point_rate, add_point_wrench  | (8) and its transpose, applied to one point               |
/// | J = J_im K(chi)  | ImageJacobian                 | push a twist, pull an image force; a matrix on request    |
/// | C in E or B      | PlatformCamera                | f and mount, which all that projects or differentiates has |
/// | J_m = J_r + J_e  | ImageJacobian at the measured depth, image_jacobian_error    |                            |
#pragma once

#include "hexservo/lens.hpp"
#include "hexservo/mount.hpp"
#include "hexservo/side_by_side.hpp"

namespace hexservo {

/// Which camera the plant has.
enum class CameraConvention {
  eye_in_hand,  ///< projects real points through (4); the physical camera
  as_printed    ///< integrates (12) with (8) as printed, which is minus the physical Jacobian (docs/errata.md, 1)
};

/// Which sign the controller gives its image Jacobian.
enum class JacobianConvention {
  consistent,  ///< the plant's sign
  printed      ///< (8) as printed, whatever the plant does
};

/// Axes of the camera's frame C and of its image.
enum class CameraAxes {
  paper,  ///< the camera looks along -z; x to the right and y up in the image
  opencv  ///< the camera looks along +z; x to the right and y down in the image
};

/// Distortion of a lens, in the order of OpenCV; none, or one of the two.
struct Distortion {
  std::optional<Vector<double, 5>> brown_conrady;   ///< k1, k2, p1, p2, k3 [1]
  std::optional<Vector<double, 4>> kannala_brandt;  ///< k1, k2, k3, k4 of a fisheye [1]

  template <class V, class... Self>
  static void visit(V&& v, Self&... self) {
    v(Field{"brown_conrady", "1"}.entrywise().of_pack(), self.brown_conrady...);
    v(Field{"kannala_brandt", "1"}.entrywise().of_pack(), self.kannala_brandt...);
  }
};

/// Numbers of a pinhole camera, prepared.
template <class S>
struct CameraParameters {
  S focal{581.816};        ///< f [px]
  Placement<S> placement;  ///< of C in E, or in B

  template <class V, class... Self>
  static void visit(V&& v, Self&... self) {
    v(Field{"focal", "px"}, self.focal...);
    v(Field{"placement"}, self.placement...);
  }
};

/// A camera as a scenario has it.
struct Camera {
  double focal_length = 0.008;                     ///< lambda [m], 0.008 (paper)
  double pixel_scale = 72727.0;                    ///< alpha [px/m], 72727 (paper)
  std::optional<Vector2<double>> focal_pixels;     ///< f_x, f_y, in place of both [px]
  std::optional<Vector2<double>> principal_point;  ///< counted from the centre of the first pixel [px]; none: pixels
                                                   ///< count from the image centre
  CameraAxes axes = CameraAxes::paper;
  Distortion distortion;
  CameraMount mount;                                       ///< of C in E, or in B
  Vector2<double> image_offset = Vector2<double>::Zero();  ///< what the principal point is off [px]; no key

  /// f of the pinhole whose features laws use [px]: f_x, or alpha lambda, 581.816.
  double focal() const { return focal_pixels ? (*focal_pixels)(0) : pixel_scale * focal_length; }

  /// Its pixels.
  /// @throws std::invalid_argument for two distortions, or one without a monotonic middle
  /// @param key that the messages name
  LensParameters<double> lens(std::string_view key = "camera") const;

  /// The numbers that projection and image Jacobian need.
  /// @throws std::invalid_argument for a rotation vector longer than pi
  /// @param key that the messages name
  CameraParameters<double> parameters(std::string_view key = "camera") const;

  template <class V, class... Self>
  static void visit(V&& v, Self&... self) {
    v(Field{"focal_length", "m", kPositive}, self.focal_length...);
    v(Field{"pixel_scale", "px/m", kPositive}, self.pixel_scale...);
    v(Field{"focal_pixels", "px", kPositive}, self.focal_pixels...);
    v(Field{"principal_point", "px"}.entrywise(), self.principal_point...);
    v(Field{"axes"}.of_pack(), self.axes...);
    v(Field{"distortion"}, self.distortion...);
    v(Field{"mount"}, self.mount...);
  }
};

/// A pinhole camera: f, and C in E, or in B where it is mounted on the base.
template <class S>
struct PlatformCamera : CameraParameters<S> {
  PlatformCamera() = default;
  /// At E's origin, with E's axes.
  PlatformCamera(const S& f) : CameraParameters<S>{f, {}} {}
  PlatformCamera(const CameraParameters<S>& camera)
      : CameraParameters<S>(camera), mounted(camera.placement.differs()) {}

  bool mounted = false;  ///< C differs from E in some lane: otherwise its operations are left out
};

/// Reference to such a camera, which must outlive it; a focal length alone is one at E.
template <class S>
struct CameraView {
  S f;                                      ///< [px]
  const Placement<S>* placement = nullptr;  ///< none: C is E

  CameraView(const S& focal) : f(focal) {}
  CameraView(const PlatformCamera<S>& camera)
      : f(camera.focal), placement(camera.mounted ? &camera.placement : nullptr) {}
  CameraView(PlatformCamera<S>&&) = delete;
  CameraView(const S& focal, const Placement<S>& at) : f(focal), placement(&at) {}
  CameraView(const S&, Placement<S>&&) = delete;

  /// Whether C is fixed in B, and the points in E.
  bool on_base() const { return placement != nullptr && placement->on_base(); }

  /// Centre of projection in the frame T that the points are fixed in [m]: p_BC, or p_EC of a camera on the base.
  Vector3<S> centre(const Vector3<S>& p_BE, const Matrix3<S>& R_BE) const {
    if (placement == nullptr) return p_BE;
    if (placement->on_base()) return rotate_back<S>(R_BE, Vector3<S>(placement->p_MC - p_BE));
    return p_BE + rotate<S>(R_BE, placement->p_MC);
  }
  /// Turns C-coordinates into those of T: R_BC, or R_EC of a camera on the base.
  Matrix3<S> attitude(const Matrix3<S>& R_BE) const {
    if (placement == nullptr) return R_BE;
    Matrix3<S> R_TC;
    for (int j = 0; j < 3; ++j) {
      const Vector3<S> axis = placement->R_MC.col(j);
      R_TC.col(j) = placement->on_base() ? rotate_back<S>(R_BE, axis) : rotate<S>(R_BE, axis);
    }
    return R_TC;
  }

  /// p_BC: centre of projection in B [m].
  Vector3<S> centre_in_base(const Vector3<S>& p_BE, const Matrix3<S>& R_BE) const {
    return on_base() ? placement->p_MC : centre(p_BE, R_BE);
  }
  /// R_BC: turns C-coordinates into B-coordinates.
  Matrix3<S> attitude_in_base(const Matrix3<S>& R_BE) const { return on_base() ? placement->R_MC : attitude(R_BE); }
  /// Frame C of a camera on the base as that of one on the platform which is at the same place at this pose.
  Placement<S> carried(const Vector3<S>& p_BE, const Matrix3<S>& R_BE) const {
    return {centre(p_BE, R_BE), attitude(R_BE), MountedOn::platform};
  }
};

/// Image and depth of N points.
template <class S, int N = kPoints>
struct Image {
  Vector<S, 2 * N> features;  ///< xi [px]
  Vector<S, N> depth;         ///< Z_i [m], negative in front of the camera

  template <class V, class... Self>
  static void visit(V&& v, Self&... self) {
    v(Field{"features", "px"}, self.features...);
    v(Field{"depth", "m"}, self.depth...);
  }
};

/// (4): xi = -f (X, Y)/Z of a point in C [m].
/// @param inverse_depth 1/Z [1/m]
template <class S>
Vector2<S> project(const S& f, const Vector3<S>& p_C, const S& inverse_depth) {
  const S scale = -f * inverse_depth;
  return Vector2<S>(scale * p_C(0), scale * p_C(1));
}
template <class S>
Vector2<S> project(const S& f, const Vector3<S>& p_C) {
  return project<S>(f, p_C, S(1.0) / p_C(2));
}

/// Inverse of (4): the point in C [m] seen at (x, y) [px] with depth Z [m].
template <class S>
Vector3<S> back_project(const S& f, const Vector2<S>& feature, const S& depth) {
  const S scale = -depth / f;
  return Vector3<S>(scale * feature(0), scale * feature(1), depth);
}

/// The point in T [m] with its image at (x, y) [px] with depth Z [m] while the platform is at this pose.
template <class S>
Vector3<S> lift(const CameraView<S>& camera, const Vector3<S>& p_BE, const Matrix3<S>& R_BE, const Vector2<S>& feature,
                const S& depth) {
  const Vector3<S> p_C = back_project<S>(camera.f, feature, depth);
  if (camera.on_base()) return rotate_back<S>(R_BE, Vector3<S>(camera.placement->in_mount(p_C) - p_BE));
  return p_BE + rotate<S>(R_BE, camera.placement == nullptr ? p_C : camera.placement->in_mount(p_C));
}

/// One number of each point, side by side.
template <class S, int N>
using PointVector = SideBySide<S, N>;

namespace detail {

/// What a camera whose own pose in T is given sees of points fixed in T: P_i = R^T (P_i^T - p), then (4).
template <class S, int N>
[[gnu::always_inline]] inline void take_image_from(const S& f, const Vector3<S>& p_TC, const Matrix3<S>& R_TC,
                                                   const Vectors3<S, N>& points_T, Image<S, N>& image,
                                                   Vector<S, N>& inverse_depth) {
  using R = typename PointVector<S, N>::Register;
  const Vector3<R> position = broadcast<R>(p_TC);
  const Matrix3<R> attitude = broadcast<R>(R_TC);
  Pairs<S, N> features;
  PointVector<S, N> depth, inverse;
  for (std::size_t r = 0; r < PointVector<S, N>::registers; ++r) {
    const Vector3<R> point = points_T.part(r);
    const Vector3<R> p_C =
        rotate_back<R>(attitude, Vector3<R>(point(0) - position(0), point(1) - position(1), point(2) - position(2)));
    inverse.part[r] = R(1.0) / p_C(2);
    const Vector2<R> feature = project<R>(R(f), p_C, inverse.part[r]);
    features.x.part[r] = feature(0);
    features.y.part[r] = feature(1);
    depth.part[r] = p_C(2);
  }
  features.store(image.features.data());
  depth.store(image.depth.data());
  inverse.store(inverse_depth.data());
}

/// The same through a mount; out of line, so that a camera without one does not pay for it.
template <class S, int N>
[[gnu::noinline]] void take_mounted_image(const CameraView<S>& camera, const Vector3<S>& p_BE, const Matrix3<S>& R_BE,
                                          const Vectors3<S, N>& points_T, Image<S, N>& image,
                                          Vector<S, N>& inverse_depth) {
  take_image_from<S, N>(camera.f, camera.centre(p_BE, R_BE), camera.attitude(R_BE), points_T, image, inverse_depth);
}

}  // namespace detail

/// Image of points fixed in T, with the platform at a pose: P_i = R_TC^T (P_i^T - p_TC), then (4).
/// T is B, and E for a camera on the base.
/// @param points_T of N points [m]
/// @param image filled in
/// @param inverse_depth 1/Z_i [1/m], a by-product; filled in
template <class S, int N>
[[gnu::always_inline]] inline void take_image(const std::type_identity_t<CameraView<S>>& camera, const Vector3<S>& p_BE,
                                              const Matrix3<S>& R_BE, const Vectors3<S, N>& points_T,
                                              Image<S, N>& image, Vector<S, N>& inverse_depth) {
  if (camera.placement == nullptr) [[likely]]
    detail::take_image_from<S, N>(camera.f, p_BE, R_BE, points_T, image, inverse_depth);
  else
    detail::take_mounted_image<S, N>(camera, Vector3<S>(p_BE), Matrix3<S>(R_BE), points_T, image, inverse_depth);
}
/// The same, for image and depth alone.
/// @param points_T 3xN, one column per point [m]
template <class S, int N>
Image<S, N> take_image(const std::type_identity_t<CameraView<S>>& camera, const Vector3<S>& p_BE,
                       const Matrix3<S>& R_BE, const Eigen::Matrix<S, 3, N>& points_T) {
  Image<S, N> image;
  Vector<S, N> inverse_depth;
  take_image<S, N>(camera, p_BE, R_BE, Vectors3<S, N>(points_T), image, inverse_depth);
  return image;
}

/// (8) applied to one point: image velocity [px/s] for the camera's velocity v and angular velocity w, both in C.
template <class S>
[[gnu::always_inline]] inline Vector2<S> point_rate(const S& f, const S& inverse_f, const S& x, const S& y,
                                                    const S& inverse_depth, const Vector3<S>& v, const Vector3<S>& w) {
  const S roll = (x * w(1) - y * w(0)) * inverse_f;  // the terms xy/f, x^2/f and y^2/f of (8) share this factor
  return Vector2<S>(-(f * v(0) + x * v(2)) * inverse_depth - x * roll - f * w(1) - y * w(2),
                    -(f * v(1) + y * v(2)) * inverse_depth - y * roll + f * w(0) + x * w(2));
}

/// Transpose of (8) for one point: adds force on C's origin and moment, both in C, for an image force (fx, fy).
template <class S>
[[gnu::always_inline]] inline void add_point_wrench(const S& f, const S& inverse_f, const S& x, const S& y,
                                                    const S& inverse_depth, const S& fx, const S& fy, Vector3<S>& force,
                                                    Vector3<S>& moment) {
  const S along = x * fx + y * fy;
  const S bend = along * inverse_f;
  force(0) -= f * fx * inverse_depth;
  force(1) -= f * fy * inverse_depth;
  force(2) -= along * inverse_depth;
  moment(0) += y * bend + f * fy;
  moment(1) -= x * bend + f * fx;
  moment(2) += x * fy - y * fx;
}

/// What each of N places counts in sums over an image: w_i >= 0 of a point, and 0 where there is none.
///
/// The weights act as if the noise of point i had 1/w_i times the variance of one that counts 1.
template <class S, int N>
class PointWeights {
 public:
  PointWeights() : weight_(Vector<S, N>::Ones()) { prepare(); }
  explicit PointWeights(const Vector<S, N>& weight) : weight_(weight) { prepare(); }

  /// w_i times the two coordinates of each point.
  Vector<S, 2 * N> times(const Vector<S, 2 * N>& image) const { return weights_.cwiseProduct(image); }
  /// Their square roots times the same: squares and products of two such vectors are weighted sums.
  Vector<S, 2 * N> root_times(const Vector<S, 2 * N>& image) const { return roots_.cwiseProduct(image); }
  /// w_i times a row.
  template <class Row>
  Row of_row(int i, const Row& row) const {
    return weight_(i) * row;
  }
  /// The square roots times numbers of the points of register r (`PointVector`).
  template <class Numbers>
  Numbers root_of_part(std::size_t r, const Numbers& numbers) const {
    return point_roots_.part[r] * numbers;
  }
  /// Weighted mean of one number of each point, w_i x_i summed over the sum of w_i.
  S share(int i) const { return weight_(i) * inverse_sum_; }
  /// Largest absolute coordinate of the points that count.
  S largest(const Vector<S, 2 * N>& image) const {
    using std::abs;
    S result(0.0);
    for (int k = 0; k < 2 * N; ++k) result = max(result, select(weights_(k) > S(0.0), S(abs(image(k))), S(0.0)));
    return result;
  }
  /// A number of a point that counts, otherwise another one.
  S where_counted(int i, const S& number, const S& otherwise) const {
    return select(weight_(i) > S(0.0), number, otherwise);
  }
  /// 1/(2 n - 6) for the n points that count: over the degrees of freedom that a pose leaves; at least one.
  const S& per_freedom() const { return per_freedom_; }

 private:
  void prepare() {
    using std::sqrt;
    S sum(0.0), counted(0.0);
    for (int i = 0; i < N; ++i) {
      sum += weight_(i);
      counted += select(weight_(i) > S(0.0), S(1.0), S(0.0));
      for (int k = 2 * i; k < 2 * i + 2; ++k) {
        weights_(k) = weight_(i);
        roots_(k) = sqrt(weight_(i));
      }
      point_roots_.set(i, roots_(2 * i));
    }
    inverse_sum_ = S(1.0) / sum;
    per_freedom_ = S(1.0) / larger(S(S(2.0) * counted - S(6.0)), S(1.0));
  }

  Vector<S, N> weight_;
  Vector<S, 2 * N> weights_, roots_;
  PointVector<S, N> point_roots_ = PointVector<S, N>::Zero();
  S inverse_sum_, per_freedom_;
};

/// The paper's four points count 1 each, which takes no operation; other weights take more places.
template <class S>
class PointWeights<S, kPoints> {
 public:
  static constexpr int N = kPoints;

  PointWeights() = default;
  explicit PointWeights(const Vector<S, N>& /*weight*/) {}

  const Vector<S, 2 * N>& times(const Vector<S, 2 * N>& image) const { return image; }
  const Vector<S, 2 * N>& root_times(const Vector<S, 2 * N>& image) const { return image; }
  template <class Row>
  const Row& of_row(int /*i*/, const Row& row) const {
    return row;
  }
  template <class Numbers>
  const Numbers& root_of_part(std::size_t /*r*/, const Numbers& numbers) const {
    return numbers;
  }
  S share(int /*i*/) const { return S(1.0 / N); }
  S largest(const Vector<S, 2 * N>& image) const { return largest_abs<S, 2 * N, 1>(image); }
  const S& where_counted(int /*i*/, const S& number, const S& /*otherwise*/) const { return number; }
  S per_freedom() const { return S(1.0 / (2 * N - 6)); }
};

namespace detail {

// Through a mount; out of line and of copies, so that the numbers of a camera without one stay in registers.

/// Velocity and angular velocity past the points, in C, for a twist of the platform in B.
template <class S>
[[gnu::noinline]] Vector6<S> camera_twist(const hexservo::Placement<S>& placement, const Vector3<S>& p_BE,
                                          const Matrix3<S>& R_BE, const Vector6<S>& twist) {
  const Vector3<S> v = twist.template head<3>(), w = twist.template tail<3>();
  // of M: E, or B against the platform
  Vector3<S> velocity = placement.on_base() ? Vector3<S>(cross<S>(w, p_BE) - v) : rotate_back<S>(R_BE, v);
  Vector3<S> turning = placement.on_base() ? Vector3<S>(-w) : rotate_back<S>(R_BE, w);
  placement.to_camera(velocity, turning);
  Vector6<S> of_camera;
  of_camera << velocity, turning;
  return of_camera;
}
/// Its transpose: force and moment on the camera, about and in C, become a wrench on the platform in B.
template <class S>
[[gnu::noinline]] Vector6<S> wrench_of_camera(const hexservo::Placement<S>& placement, const Vector3<S>& p_BE,
                                              const Matrix3<S>& R_BE, Vector3<S> force, Vector3<S> moment) {
  placement.to_mount(force, moment);
  Vector6<S> wrench;
  if (placement.on_base())
    wrench << -force, cross<S>(p_BE, force) - moment;
  else
    wrench << rotate<S>(R_BE, force), rotate<S>(R_BE, moment);
  return wrench;
}
/// Information about a displacement of the camera, in C, becomes that about one of the platform, in B.
/// @param information its lower triangle is read, and given
template <class S>
[[gnu::noinline, gnu::cold]] Matrix6<S> information_on_camera(const hexservo::Placement<S>& placement,
                                                              const Vector3<S>& p_BE, const Matrix3<S>& R_BE,
                                                              Matrix6<S> information) {
  for (int j = 1; j < 6; ++j)
    for (int i = 0; i < j; ++i) information(i, j) = information(j, i);
  for (int side = 0; side < 2; ++side) {
    Matrix6<S> turned;
    for (int j = 0; j < 6; ++j) {
      const Vector6<S> column = information.col(j);
      turned.row(j) = wrench_of_camera<S>(placement, p_BE, R_BE, Vector3<S>(column.template head<3>()),
                                          Vector3<S>(column.template tail<3>()))
                          .transpose();
    }
    information = turned;
  }
  return information;
}

}  // namespace detail

/// A Jacobian of the image by its rows, those of the points of a register side by side: in B, or through a mount in C.
template <class S, int N = kPoints>
struct ImageRows {
  using Register = typename PointVector<S, N>::Register;
  static constexpr std::size_t registers = PointVector<S, N>::registers;

  std::array<Vector6<Register>, registers> x, y;  ///< of the points' x and y [px/m; px/rad]

  /// J^T J, 6 x 6: its lower triangle.
  [[gnu::always_inline]] Matrix6<S> normal_matrix() const {
    return lower_lane_sums<S>([this](int i, int j) {
      Register sum = x[0](i) * x[0](j) + y[0](i) * y[0](j);
      for (std::size_t r = 1; r < registers; ++r) sum += x[r](i) * x[r](j) + y[r](i) * y[r](j);
      return sum;
    });
  }

  /// As a 2N x 6 matrix.
  Eigen::Matrix<S, 2 * N, 6> matrix() const {
    Eigen::Matrix<S, 2 * N, 6> J;
    for (int k = 0; k < 6; ++k) {
      Pairs<S, N> column;
      for (std::size_t r = 0; r < registers; ++r) {
        column.x.part[r] = x[r](k);
        column.y.part[r] = y[r](k);
      }
      J.col(k) = column.vector();
    }
    return J;
  }

  friend ImageRows mean(const ImageRows& a, const ImageRows& b) {
    ImageRows half;
    for (std::size_t r = 0; r < registers; ++r) {
      half.x[r] = Register(0.5) * (a.x[r] + b.x[r]);
      half.y[r] = Register(0.5) * (a.y[r] + b.y[r]);
    }
    return half;
  }
};

/// J = sign J_im(xi, Z) blkdiag(R^T, R^T) of (12): twist in B to image velocity; applied point by point. Through a
/// mount the twist at E becomes that of the camera first, v_C = v + w x (R r). Of a camera on the base it is that of B
/// against the platform, -(v - w x x_p) at B's origin and -w, which takes the place of the twist of E.
///
/// With sign = -1 this is the Jacobian of real points, fixed in B or E; +1 is (8) as printed.
/// (8) changes its sign with x, y and f, so they carry it.
template <class S, int N = kPoints>
class ImageJacobian {
 public:
  /// @param features [px]
  /// @param inverse_depth 1/Z_i [1/m], measured or true
  /// @param p_BE, R_BE pose of the platform; shared: they must outlive this
  ImageJacobian(const CameraView<S>& camera, const S& sign, const Vector<S, 2 * N>& features,
                const Vector<S, N>& inverse_depth, const Vector3<S>& p_BE, const Matrix3<S>& R_BE)
      : f_(sign * camera.f),
        inverse_f_(S(1.0) / f_),
        inverse_depth_(PointVector<S, N>::load(inverse_depth.data())),
        p_BE_(p_BE),
        R_BE_(R_BE),
        placement_(camera.placement) {
    const Pairs<S, N> pairs(features);
    points_.x = sign * pairs.x;
    points_.y = sign * pairs.y;
  }

  /// @param image features [px] and depth [m], measured or true; depth must not be zero
  ImageJacobian(const CameraView<S>& camera, const S& sign, const Image<S, N>& image, const Vector3<S>& p_BE,
                const Matrix3<S>& R_BE)
      : ImageJacobian(camera, sign, image.features, image.depth.cwiseInverse(), p_BE, R_BE) {}

  // What is, or may be, shared must have a name: a temporary is gone before the Jacobian is used.
  ImageJacobian(const CameraView<S>&, const S&, Vector<S, 2 * N>&&, const Vector<S, N>&, const Vector3<S>&,
                const Matrix3<S>&) = delete;
  ImageJacobian(const CameraView<S>&, const S&, const Vector<S, 2 * N>&, const Vector<S, N>&, const Vector3<S>&,
                Matrix3<S>&&) = delete;
  ImageJacobian(const CameraView<S>&, const S&, const Vector<S, 2 * N>&, const Vector<S, N>&, Vector3<S>&&,
                const Matrix3<S>&) = delete;
  ImageJacobian(const CameraView<S>&, const S&, Image<S, N>&&, const Vector3<S>&, const Matrix3<S>&) = delete;
  ImageJacobian(const CameraView<S>&, const S&, const Image<S, N>&, const Vector3<S>&, Matrix3<S>&&) = delete;
  ImageJacobian(const CameraView<S>&, const S&, const Image<S, N>&, Vector3<S>&&, const Matrix3<S>&) = delete;

  /// J chi-dot [px/s] for a twist in B.
  Vector<S, 2 * N> push(const Vector6<S>& twist) const { return push_pairs(twist).vector(); }
  [[gnu::always_inline]] Pairs<S, N> push_pairs(const Vector6<S>& twist) const {
    Vector3<S> velocity, turning;
    if (placement_ == nullptr) [[likely]] {
      velocity = rotate_back<S>(R_BE_, Vector3<S>(twist(0), twist(1), twist(2)));
      turning = rotate_back<S>(R_BE_, Vector3<S>(twist(3), twist(4), twist(5)));
    } else {
      const Vector6<S> of_camera =
          detail::camera_twist<S>(*placement_, Vector3<S>(p_BE_), Matrix3<S>(R_BE_), Vector6<S>(twist));
      velocity = of_camera.template head<3>();
      turning = of_camera.template tail<3>();
    }
    const Vector3<R> v = broadcast<R>(velocity), w = broadcast<R>(turning);
    Pairs<S, N> rates;
    for (std::size_t r = 0; r < registers; ++r) {
      const Vector2<R> rate =
          point_rate<R>(R(f_), R(inverse_f_), points_.x.part[r], points_.y.part[r], inverse_depth_.part[r], v, w);
      rates.x.part[r] = rate(0);
      rates.y.part[r] = rate(1);
    }
    return rates;
  }

  /// J^T p, a wrench in B, for an image force p (2N).
  SideBySide<S, 6> pull(const Pairs<S, N>& image_force) const {
    Vector3<R> force(R(0.0), R(0.0), R(0.0)), moment(R(0.0), R(0.0), R(0.0));
    for (std::size_t r = 0; r < registers; ++r)
      add_point_wrench<R>(R(f_), R(inverse_f_), points_.x.part[r], points_.y.part[r], inverse_depth_.part[r],
                          image_force.x.part[r], image_force.y.part[r], force, moment);
    Vectors3<S, 2> wrench;  // force and moment side by side, in C
    wrench.x = lane_sums<S>(force(0), moment(0));
    wrench.y = lane_sums<S>(force(1), moment(1));
    wrench.z = lane_sums<S>(force(2), moment(2));
    if (placement_ != nullptr) [[unlikely]]
      return SideBySide<S, 6>(detail::wrench_of_camera<S>(*placement_, Vector3<S>(p_BE_), Matrix3<S>(R_BE_),
                                                          wrench.column(0), wrench.column(1)));
    return stacked<S>(rotate<S, 2>(R_BE_, wrench));
  }

  /// J as a 2N x 6 matrix: twist in B (m/s; rad/s) to image velocity [px/s].
  Eigen::Matrix<S, 2 * N, 6> matrix() const {
    Eigen::Matrix<S, 2 * N, 6> J = rows({}).matrix();
    if (placement_ == nullptr) return J;
    for (int i = 0; i < 2 * N; ++i) {
      const Vector6<S> in_camera = J.row(i).transpose();
      J.row(i) = detail::wrench_of_camera<S>(*placement_, p_BE_, R_BE_, in_camera.template head<3>(),
                                             in_camera.template tail<3>())
                     .transpose();
    }
    return J;
  }

  /// W^(1/2) J by its rows.
  [[gnu::always_inline]] ImageRows<S, N> rows(const PointWeights<S, N>& weights) const {
    const Matrix3<R> turn = broadcast<R>(placement_ == nullptr ? R_BE_ : Matrix3<S>(Matrix3<S>::Identity()));
    ImageRows<S, N> J;
    for (std::size_t r = 0; r < registers; ++r) {
      J.x[r] = weights.root_of_part(r, rows_of_part(r, R(1.0), R(0.0), turn));
      J.y[r] = weights.root_of_part(r, rows_of_part(r, R(0.0), R(1.0), turn));
    }
    return J;
  }

  /// J^T W J, 6 x 6: information in the image about a displacement in B [px^2/m^2 ... px^2/rad^2]; its lower triangle,
  /// which `Cholesky` reads.
  Matrix6<S> normal_matrix(const PointWeights<S, N>& weights = {}) const { return normal_matrix(rows(weights)); }
  /// The same of other rows, those of a Jacobian at this pose of the platform or a mean of some.
  [[gnu::always_inline]] Matrix6<S> normal_matrix(const ImageRows<S, N>& J) const {
    const Matrix6<S> information = J.normal_matrix();
    if (placement_ != nullptr) [[unlikely]]
      return detail::information_on_camera<S>(*placement_, Vector3<S>(p_BE_), Matrix3<S>(R_BE_), information);
    return information;
  }

 private:
  using R = typename PointVector<S, N>::Register;
  static constexpr std::size_t registers = PointVector<S, N>::registers;

  /// fx times the rows of J for x of the points of a register, plus fy times those for y: force and moment in C, turned
  /// by a matrix.
  [[gnu::always_inline]] Vector6<R> rows_of_part(std::size_t r, const R& fx, const R& fy,
                                                 const Matrix3<R>& turn) const {
    Vector3<R> force(R(0.0), R(0.0), R(0.0)), moment(R(0.0), R(0.0), R(0.0));
    add_point_wrench<R>(R(f_), R(inverse_f_), points_.x.part[r], points_.y.part[r], inverse_depth_.part[r], fx, fy,
                        force, moment);
    const Vector3<R> turned = rotate<R>(turn, force), about = rotate<R>(turn, moment);
    Vector6<R> wrench;
    for (int k = 0; k < 3; ++k) {
      wrench(k) = turned(k);
      wrench(k + 3) = about(k);
    }
    return wrench;
  }

  S f_, inverse_f_;     ///< with the sign
  Pairs<S, N> points_;  ///< likewise
  PointVector<S, N> inverse_depth_;
  const Vector3<S>& p_BE_;
  const Matrix3<S>& R_BE_;
  const Placement<S>* placement_;  ///< of C in E or B; none: C is E
};

/// The controller's depth estimates, Z-hat_i = (1 + delta_Z,i) Z_i (docs/model.md, section 4) [m].
template <class S, int N>
Image<S, N> measured_image(const Image<S, N>& image, const Vector<S, N>& depth_error) {
  return {image.features, image.depth + depth_error.cwiseProduct(image.depth)};
}

/// What makes 1/Z-hat_i of 1/Z_i: 1/(1 + delta_Z,i) [1].
template <class S, int N>
Vector<S, N> measured_inverse_share(const Vector<S, N>& depth_error) {
  return (Vector<S, N>::Ones() + depth_error).cwiseInverse();
}

/// Delta-J of (12): measured minus real image Jacobian, 2N x 6, at one pose.
template <class S, int N>
Eigen::Matrix<S, 2 * N, 6> image_jacobian_error(const std::type_identity_t<CameraView<S>>& camera, const S& sign,
                                                const Image<S, N>& image, const Vector<S, N>& depth_error,
                                                const Vector3<S>& p_BE, const Matrix3<S>& R_BE) {
  const Image<S, N> measured = measured_image(image, depth_error);
  return ImageJacobian<S, N>(camera, sign, measured, p_BE, R_BE).matrix() -
         ImageJacobian<S, N>(camera, sign, image, p_BE, R_BE).matrix();
}

/// Z-dot_i [m/s] of (6) as printed: (omega x P_i + v) along Z, in E, with P_i from (4).
template <class S, int N>
Vector<S, N> printed_depth_rate(const S& f, const Image<S, N>& image, const Matrix3<S>& R_BE, const Vector6<S>& twist) {
  const Vector3<S> v_E = rotate_back<S>(R_BE, twist.template head<3>());
  const Vector3<S> w_E = rotate_back<S>(R_BE, twist.template tail<3>());
  Vector<S, N> rates;
  for (int i = 0; i < N; ++i) {
    const Vector2<S> feature = image.features.template segment<2>(2 * i);
    const Vector3<S> p_E = back_project<S>(f, feature, image.depth(i));
    rates(i) = w_E.cross(p_E)(2) + v_E(2);
  }
  return rates;
}

/// Sign of the plant's image Jacobian relative to (8).
constexpr double plant_sign(CameraConvention camera) { return camera == CameraConvention::as_printed ? 1.0 : -1.0; }
/// Sign of the controller's image Jacobian relative to (8).
constexpr double controller_sign(CameraConvention camera, JacobianConvention jacobian) {
  return jacobian == JacobianConvention::printed ? 1.0 : plant_sign(camera);
}

}  // namespace hexservo
