/// @file
/// Platform, camera and target as they really are, driven by a wrench: what both loops integrate
/// (docs/model.md, sections 3, 4 and 7).
#pragma once

#include "hexservo/loop_parameters.hpp"
#include "hexservo/runge_kutta.hpp"

namespace hexservo {

/// Attitude, and the image there.
template <class S, int N = kPoints>
struct View {
  View() = default;
  View(const Image<S, N>& true_image, const Matrix3<S>& attitude)
      : R_BE(attitude), image(true_image), inverse_depth(true_image.depth.cwiseInverse()) {}

  Matrix3<S> R_BE;
  Image<S, N> image;           ///< true features and depth; integrated where the camera is as printed
  Vector<S, N> inverse_depth;  ///< [1/m]
};

/// Where the platform is and how it moves, with the image of the target.
template <class S, int N = kPoints>
struct WorldState {
  BodyMotion<S> body;
  View<S, N> view;
};

/// Time derivative of a state.
template <class S, int N = kPoints>
struct WorldRate {
  BodyMotion<S> body;
  Image<S, N> printed_image;  ///< of the image as (12) and (6) print it; unused by a camera that projects
  S nearest_depth;            ///< largest Z_i of the state [m]
};

/// Largest Z_i: a point is behind the camera where it is not negative [m]; NaN shows in the state that follows.
template <class S, int N>
S nearest_depth(const Image<S, N>& image) noexcept {
  S nearest = image.depth(0);
  for (int i = 1; i < N; ++i) nearest = larger(nearest, image.depth(i));
  return nearest;
}

/// body + scale rate: the platform in a Runge-Kutta stage; its quaternion is not normalised inside a step.
template <class S>
[[gnu::always_inline]] inline void move_body(const BodyMotion<S>& body, const S& scale, const BodyMotion<S>& rate,
                                             BodyMotion<S>& out) noexcept {
  out.position = body.position + scale * rate.position;
  out.quaternion = body.quaternion + scale * rate.quaternion;
  out.twist = body.twist + scale * rate.twist;
}

/// The platform after a step of h [s] from the rates of its four stages, its quaternion normalised.
template <class S>
[[gnu::always_inline]] inline BodyMotion<S> body_after(BodyMotion<S> body, double h,
                                                       const std::array<const BodyMotion<S>*, 4>& rates) noexcept {
#pragma GCC unroll 4
  for (std::size_t i = 0; i < 4; ++i) body = body + S(h * kRungeKuttaWeights[i]) * *rates[i];
  normalise_quaternion(body);
  return body;
}

/// What is, in `active` lanes, and what was in the others.
template <class S, int N>
void replace(WorldState<S, N>& state, const WorldState<S, N>& next, const Mask<S>& active) noexcept {
  if (all(active)) {
    state = next;
    return;
  }
  state.body = select(active, next.body, state.body);
  state.view.R_BE = select(active, next.view.R_BE, state.view.R_BE);
  state.view.image.features = select(active, next.view.image.features, state.view.image.features);
  state.view.image.depth = select(active, next.view.image.depth, state.view.image.depth);
  state.view.inverse_depth = select(active, next.view.inverse_depth, state.view.inverse_depth);
}

/// The actual plant of a scenario.
template <class S, int N = kPoints>
class World {
 public:
  explicit World(const SceneParameters<S, N>& p)
      : plant_(p.plant_body, p.dynamics_error), camera_(p.camera), points_T_(p.points_T), convention_(p.convention) {}

  /// Where a run starts.
  WorldState<S, N> start(const SceneParameters<S, N>& p) const noexcept {
    const auto body = BodyMotion<S>::of(body_state<S>(p.start, p.start_twist));
    return {body, printed_camera() ? View<S, N>(p.initial_image, rotation_matrix(quaternion_of(body))) : view_of(body)};
  }

  /// Moves the target's points: what is seen from here on, 3xN in B [m]; not of a camera on the base.
  void place_target(const Eigen::Matrix<S, 3, N>& points_T) noexcept { points_T_ = Vectors3<S, N>(points_T); }

  /// How a state changes under a wrench in B [N; N m].
  void rate(const WorldState<S, N>& state, const Vector6<S>& wrench, WorldRate<S, N>& out) const noexcept {
    out.body = body_rate(plant_, state.body, state.view.R_BE, wrench);
    out.nearest_depth = nearest_depth(state.view.image);
    if (printed_camera()) {
      const Vector6<S> twist = twist_of(state.body);
      const Vector3<S> position = position_of(state.body);
      const ImageJacobian<S, N> J(camera_, S(plant_sign(convention_)), state.view.image, position, state.view.R_BE);
      out.printed_image.features = J.push(twist);  // (12)
      out.printed_image.depth = printed_depth_rate(camera_.focal, state.view.image, state.view.R_BE, twist);
    }
  }

  /// The image where a platform is that nothing integrates; of a camera that projects.
  WorldState<S, N> seen_from(const BodyMotion<S>& body) const noexcept { return {body, view_of(body)}; }

  /// D of the platform without its legs.
  [[gnu::noinline, gnu::cold]] Matrix6<S> mass_matrix(const Matrix3<S>& R_BE) const noexcept {
    return plant_.mass_matrix_at(R_BE);
  }

  /// What it takes to accelerate the platform so (m/s^2; rad/s^2, in B), (3) turned around, in B [N; N m].
  [[gnu::noinline, gnu::cold]] Vector6<S> needed_wrench(const BodyMotion<S>& body, const Matrix3<S>& R_BE,
                                                        const Vector6<S>& acceleration) const noexcept {
    const Vector6<S> twist = twist_of(body);
    const Matrix6<S> D = plant_.mass_matrix_at(R_BE), C = plant_.coriolis_matrix_at(R_BE, twist);
    Vector6<S> wrench = plant_.weight_at(R_BE);
    for (int j = 0; j < 6; ++j)
      for (int i = 0; i < 6; ++i) wrench(i) += D(i, j) * acceleration(j) + C(i, j) * twist(j);
    return wrench;
  }

  /// What an acceleration of B [m/s^2] adds to a wrench in B [N; N m].
  Vector6<S> inertial_wrench(const Matrix3<S>& R_BE, const Vector3<S>& acceleration_B) const noexcept {
    return hexservo::inertial_wrench(plant_, R_BE, acceleration_B);
  }

  /// What a base that turns adds to a wrench in B [N; N m].
  Vector6<S> moving_base_wrench(const BodyMotion<S>& body, const Matrix3<S>& R_BE,
                                const BaseState<S>& base) const noexcept {
    return hexservo::moving_base_wrench(plant_, position_of(body), R_BE, twist_of(body), base);
  }

  /// state + scale rate: a Runge-Kutta stage.
  WorldState<S, N> moved(const WorldState<S, N>& state, const S& scale, const WorldRate<S, N>& rate) const noexcept {
    WorldState<S, N> next;
    move_body(state.body, scale, rate.body, next.body);
    if (printed_camera())
      next.view = View<S, N>({state.view.image.features + scale * rate.printed_image.features,
                              state.view.image.depth + scale * rate.printed_image.depth},
                             rotation_matrix(quaternion_of(next.body)));
    else
      look(next.body, next.view);
    return next;
  }

  /// The state after a step of h [s], from the rates of its four stages.
  WorldState<S, N> after(const WorldState<S, N>& state, double h,
                         const std::array<const WorldRate<S, N>*, 4>& rates) const noexcept {
    WorldState<S, N> next;
    next.body = body_after<S>(state.body, h, {&rates[0]->body, &rates[1]->body, &rates[2]->body, &rates[3]->body});
    if (!printed_camera()) {
      look(next.body, next.view);
      return next;
    }
    Image<S, N> image = state.view.image;
    for (std::size_t i = 0; i < 4; ++i) {
      image.features += S(h * kRungeKuttaWeights[i]) * rates[i]->printed_image.features;
      image.depth += S(h * kRungeKuttaWeights[i]) * rates[i]->printed_image.depth;
    }
    next.view = View<S, N>(image, rotation_matrix(quaternion_of(next.body)));
    return next;
  }

 private:
  bool printed_camera() const noexcept { return convention_ == CameraConvention::as_printed; }

  /// Fills in the image; in place, since a copy would be waited for.
  [[gnu::always_inline]] inline void look(const BodyMotion<S>& body, View<S, N>& view) const noexcept {
    view.R_BE = rotation_matrix(quaternion_of(body));
    take_image<S, N>(camera_, position_of(body), view.R_BE, points_T_, view.image, view.inverse_depth);
  }
  View<S, N> view_of(const BodyMotion<S>& body) const noexcept {
    View<S, N> view;
    look(body, view);
    return view;
  }

  Plant<S> plant_;
  PlatformCamera<S> camera_;
  Vectors3<S, N> points_T_;
  CameraConvention convention_;
};

/// Largest Z_i of a step: of its end, and of its stages, since a pole may lie inside the step [m].
template <class S, int N>
S nearest_depth(const WorldState<S, N>& end, const std::array<const WorldRate<S, N>*, 4>& rates) noexcept {
  S nearest = nearest_depth(end.view.image);
  for (std::size_t i = 1; i < 4; ++i) nearest = larger(nearest, rates[i]->nearest_depth);
  return nearest;
}

}  // namespace hexservo
