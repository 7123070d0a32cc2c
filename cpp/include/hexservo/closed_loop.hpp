/// @file
/// The closed loop in continuous time: the law acts inside every Runge-Kutta stage (docs/model.md, section 7).
///
/// `ClosedLoop<S, Law>` is a stepper: parameters are const and shared, the state is a value, nothing is allocated, and
/// nothing branches on data, so that the same source runs one scenario (`double`) or one per lane (`Lanes<W>`). The
/// loop with a camera and a servo that have periods: sampled_loop.hpp.
#pragma once

#include "hexservo/loop_record.hpp"

namespace hexservo {

/// Plant and law in continuous time, from home, at rest.
template <class S, class Law, int N = kPoints>
class ClosedLoop {
 public:
  using Parameters = LoopParameters<S, Law, N>;
  using LawState = typename Law::template State<S>;

  /// @param parameters shared, not copied: they must outlive the loop
  explicit ClosedLoop(const Parameters& parameters)
      : p_(parameters),
        task_(control_task(p_)),
        law_(p_.gains),
        world_(p_),
        inverse_depth_share_((Vector<S, N>::Ones() + p_.depth_error).cwiseInverse()),
        state_(world_.start(p_)),
        law_state_(Law::initial_state(p_.gains)),
        record_(p_, state_) {
    evaluate(state_, LawStage{&law_state_}, now_);
    record_.accept(0.0, state_, now_.law.wrench, now_.law.fuzzy_output);
  }

  ClosedLoop(const ClosedLoop&) = delete;  // refers into its parameters
  ClosedLoop& operator=(const ClosedLoop&) = delete;

  /// What the sensors give now.
  Measurement<S, N> observe() const noexcept {
    return {measured_image(state_.view.image, p_.depth_error),
            {position_of(state_.body), quaternion_of(state_.body)},
            twist_of(state_.body)};
  }

  /// One Runge-Kutta step; lanes that have stopped stay as they are.
  void advance() noexcept {
    const double h = p_.step;
    const auto derivative_at = [this](double scale, const Instant& before) {
      Instant instant;
      evaluate(world_.moved(state_, S(scale), before.world), LawStage{&law_state_, &before.law.rate, S(scale)},
               instant);
      return instant;
    };
    runge_kutta_step(h, now_, derivative_at, [this, h](const std::array<const Instant*, 4>& k) { commit(h, k); });
    evaluate(state_, LawStage{&law_state_}, now_);
    record_.accept(time(), state_, now_.law.wrench, now_.law.fuzzy_output);
  }

  /// Time that was last asked for [s]; lanes that have stopped are behind it.
  double time() const noexcept { return static_cast<double>(steps_) * p_.step; }
  long long steps() const noexcept { return steps_; }
  const LoopRecord<S, N>& record() const noexcept { return record_; }
  const LawState& law_state() const noexcept { return law_state_; }

 private:
  using LawStage = typename Law::template Stage<S>;
  using LawRate = typename Law::template Rate<S>;

  /// How everything changes at one instant, and what the law does.
  struct Instant {
    typename Law::template Evaluation<S> law;
    WorldRate<S, N> world;
  };

  void evaluate(const WorldState<S, N>& state, const LawStage& stage, Instant& out) const noexcept {
    const Vector6<S> twist = twist_of(state.body);
    const Vector<S, N> inverse_depth = inverse_depth_share_.cwiseProduct(state.view.inverse_depth);  // (1 + delta_Z) Z
    const Pose<S> pose{position_of(state.body), quaternion_of(state.body)};
    Law::evaluate(task_, law_, stage,
                  LawInput<S, N>{state.view.image.features, inverse_depth, state.view.R_BE, twist, pose}, out.law);
    world_.rate(state, out.law.wrench, out.world);
  }

  /// Ends a step: the new state where it is good, the old one where the lane stops or has stopped.
  void commit(double h, const std::array<const Instant*, 4>& k) noexcept {
    const std::array<const WorldRate<S, N>*, 4> world_rates{&k[0]->world, &k[1]->world, &k[2]->world, &k[3]->world};
    const std::array<const LawRate*, 4> law_rates{&k[0]->law.rate, &k[1]->law.rate, &k[2]->law.rate, &k[3]->law.rate};
    std::array<S, 4> scales;
    for (std::size_t i = 0; i < 4; ++i) scales[i] = S(h * kRungeKuttaWeights[i]);
    const WorldState<S, N> next = world_.after(state_, h, world_rates);
    ++steps_;
    record_.judge(next, nearest_depth(next, world_rates));
    const Mask<S> active = record_.running();
    Law::advance(law_, law_state_, law_rates, scales, active);
    replace(state_, next, active);
  }

  const Parameters& p_;
  ControlTask<S, N> task_;
  typename Law::template Constants<S> law_;
  World<S, N> world_;
  Vector<S, N> inverse_depth_share_;  ///< 1/(1 + delta_Z,i) [1]
  WorldState<S, N> state_;
  LawState law_state_;
  LoopRecord<S, N> record_;
  Instant now_;
  long long steps_ = 0;
};

}  // namespace hexservo
