/// @file
/// Position-based visual servoing: a pose from the features and assumed points, then a Cartesian law
/// (docs/model.md, section 5).
#pragma once

#include "hexservo/laws/law_without_fuzzy.hpp"
#include "hexservo/target_model.hpp"

#include <array>
#include <cstddef>

namespace hexservo {

/// Gains of the law `pbvs`.
template <class S, int N = kPoints>
struct PbvsGains {
  Vector6<S> kp{S(24.0), S(24.0), S(24.0),
                S(0.06), S(0.06), S(0.12)};  ///< diagonal of K_p [N/m; N m/rad], 24 x3, 0.06 x2, 0.12
  Vector6<S> kd{S(2.4),  S(2.4),  S(2.4),
                S(6e-3), S(6e-3), S(1.2e-2)};  ///< diagonal of K_d [N s/m; N m s/rad], 2.4 x3, 6e-3 x2, 1.2e-2

  /// Diagonal of M under noise [px^2/m^2; px^2/rad^2], 1e5 x3, 16000 x3
  Vector6<S> prior = linear_angular<S>(1e5, 16000.0);

  /// The task has to hold the pose of the goal.
  static constexpr bool needs_goal() { return true; }

  template <class V, class... Self>
  static void visit(V&& v, Self&... self) {
    v(Field{"kp", "N/m; N m/rad", kNotNegative}, self.kp...);
    v(Field{"kd", "N s/m; N m s/rad", kNotNegative}, self.kd...);
    v(Field{"prior", "px^2/m^2; px^2/rad^2", kNotNegative}, self.prior...);
  }
};

/// The law as a policy of the loop. Its state is where the last estimate was, which changes how fast one is found
/// alone.
struct Pbvs : LawWithoutFuzzy<PbvsGains, PoseMemory> {
  static constexpr LawTraits traits = {.name = "pbvs",
                                       .type = "Pbvs",
                                       .parts = {LawPart::damping, LawPart::pose_spring},
                                       .viscosity = "kd",
                                       .points = true,
                                       .prior = true};

  /// Where the estimate of an evaluation starts: at that of the stage before, or of the step before.
  template <class S>
  struct Stage {
    explicit Stage(const State<S>* state, const Rate<S>* before = nullptr, const S& /*scale*/ = S(0.0))
        : near(before == nullptr ? *state : *before) {}
    const PoseMemory<S>& near;
  };

  /// What the wrench changes with the twist by: at K_d^-1 K_p (chi_goal - chi-hat) it is G.
  template <class S, int N>
  static const Vector6<S>& viscosity(const PbvsGains<S, N>& gains) {
    return gains.kd;
  }

  /// tau = K_p (chi_goal - chi-hat) - K_d chi-dot + G, with chi-hat from the features by `estimate_pose_near`: the pose
  /// of the joint sensors is where a search starts and, with M > 0, weighed against the image as far as that is noisy.
  /// NaN where there is no estimate.
  template <class S, int N, class Listener = NoListener>
  static void evaluate(const ControlTask<S, N>& task, const Constants<S, N>& gains, const Stage<S>& stage,
                       const LawInput<S, N>& input, Evaluation<S>& out, const Listener& listener = {}) noexcept {
    out.rate = stage.near;
    const Pose<S> estimate = estimate_pose_near<S, N>(task.camera, task.target.points_T, input.features, input.pose,
                                                      gains.prior, out.rate, task.weights);
    const Vector6<S> error = pose_difference(task.target.goal, estimate);
    out.wrench = gains.kp.cwiseProduct(error) - gains.kd.cwiseProduct(input.twist) + task.gravity_wrench;
    task.add_weight_moment(input.R_BE, out.wrench);
    listener.pose_error([&] { return error; });
    listener.part(LawPart::damping, [&] { return Vector6<S>(-gains.kd.cwiseProduct(input.twist)); });
    listener.part(LawPart::pose_spring, [&] { return Vector6<S>(gains.kp.cwiseProduct(error)); });
  }

  /// Keeps what the last evaluation left.
  template <class S, int N, std::size_t K>
  static void advance(const Constants<S, N>& /*constants*/, State<S>& state, const std::array<const Rate<S>*, K>& rates,
                      const std::array<S, K>& /*scales*/, const Mask<S>& active) noexcept {
    state.replace(active, *rates.back());
  }
};

}  // namespace hexservo
