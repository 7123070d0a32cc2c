/// @file
/// The closed loop in continuous time: the law acts inside every Runge-Kutta stage (docs/model.md, section 7).
///
/// `ClosedLoop<S, Law>` is a stepper: parameters are const and shared, the state is a value, nothing is allocated, and
/// nothing branches on data, so that the same source runs one scenario (`double`) or one per lane (`Lanes<W>`). The
/// loop with a camera and a servo that have periods: sampled_loop.hpp.
#pragma once

#include "hexservo/loop_record.hpp"

namespace hexservo {

/// How plant and law change in continuous time: the stages of a Runge-Kutta step, and its end. It holds no state.
template <class S, class Law, int N = kPoints>
class LoopEquations {
 public:
  using LawState = typename Law::template State<S>;
  using LawStage = typename Law::template Stage<S>;

  /// How everything changes at one instant, and what the law does.
  struct Instant {
    typename Law::template Evaluation<S> law;
    WorldRate<S, N> world;
  };
  using Instants = std::array<const Instant*, 4>;  ///< of a step's stages

  explicit LoopEquations(const LoopParameters<S, Law, N>& p)
      : task_(control_task(p)), law_(p.gains), world_(p), inverse_depth_share_(measured_inverse_share(p.depth_error)) {}

  const World<S, N>& world() const noexcept { return world_; }

  /// The law at an instant.
  /// @param listener receives what a law reports of its work, see `NoListener`
  template <class... Listener>
  [[gnu::always_inline]] inline void evaluate(const LawStage& stage, const LawInput<S, N>& input,
                                              typename Law::template Evaluation<S>& out,
                                              const Listener&... listener) const noexcept {
    Law::evaluate(task_, law_, stage, input, out, listener...);
  }

  /// Law and plant at an instant.
  void evaluate(const WorldState<S, N>& state, const LawStage& stage, Instant& out) const noexcept {
    const Vector6<S> twist = twist_of(state.body);
    const Vector<S, N> inverse_depth = inverse_depth_share_.cwiseProduct(state.view.inverse_depth);
    const Pose<S> pose{position_of(state.body), quaternion_of(state.body)};
    evaluate(stage, LawInput<S, N>{state.view.image.features, inverse_depth, state.view.R_BE, twist, pose}, out.law);
    world_.rate(state, out.law.wrench, out.world);
  }

  /// A stage of the step from `start`: `scale` [s] along the rate of the stage before.
  /// @param out law and plant there
  /// @return where it is
  [[gnu::always_inline]] inline WorldState<S, N> stage(const WorldState<S, N>& start, const LawState& law_state,
                                                       const S& scale, const Instant& before,
                                                       Instant& out) const noexcept {
    const WorldState<S, N> state = world_.moved(start, scale, before.world);
    evaluate(state, LawStage{&law_state, &before.law.rate, scale}, out);
    return state;
  }

  /// Plant and camera after a step of h [s].
  /// @param nearest largest Z_i on the way there [m]
  [[gnu::always_inline]] inline WorldState<S, N> after(const WorldState<S, N>& start, double h, const Instants& k,
                                                       S& nearest) const noexcept {
    const std::array<const WorldRate<S, N>*, 4> rates{&k[0]->world, &k[1]->world, &k[2]->world, &k[3]->world};
    const WorldState<S, N> next = world_.after(start, h, rates);
    nearest = nearest_depth(next, rates);
    return next;
  }

  /// The law's state after a step of h [s], in `active` lanes.
  [[gnu::always_inline]] inline void advance(LawState& state, double h, const Instants& k,
                                             const Mask<S>& active) const noexcept {
    using Rate = typename Law::template Rate<S>;
    const std::array<const Rate*, 4> rates{&k[0]->law.rate, &k[1]->law.rate, &k[2]->law.rate, &k[3]->law.rate};
    std::array<S, 4> scales;
    for (std::size_t i = 0; i < 4; ++i) scales[i] = S(h * kRungeKuttaWeights[i]);
    Law::advance(law_, state, rates, scales, active);
  }

 private:
  ControlTask<S, N> task_;
  typename Law::template Constants<S, N> law_;
  World<S, N> world_;
  Vector<S, N> inverse_depth_share_;
};

/// Plant and law in continuous time.
template <class S, class Law, int N = kPoints>
class ClosedLoop {
 public:
  using Parameters = LoopParameters<S, Law, N>;
  using LawState = typename Law::template State<S>;

  /// @param parameters shared, not copied: they must outlive the loop
  explicit ClosedLoop(const Parameters& parameters)
      : p_(parameters),
        equations_(p_),
        state_(equations_.world().start(p_)),
        law_state_(Law::initial_state(p_.gains)),
        record_(p_, state_) {
    evaluate();
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
      equations_.stage(state_, law_state_, S(scale), before, instant);
      return instant;
    };
    runge_kutta_step(h, now_, derivative_at, [this, h](const Instants& k) { commit(h, k); });
    evaluate();
    record_.accept(time(), state_, now_.law.wrench, now_.law.fuzzy_output);
  }

  /// After the last step.
  void finish() noexcept { record_.finish(); }

  /// Time that was last asked for [s]; lanes that have stopped are behind it.
  double time() const noexcept { return static_cast<double>(steps_) * p_.step; }
  long long steps() const noexcept { return steps_; }
  const LoopRecord<S, N>& record() const noexcept { return record_; }
  const LawState& law_state() const noexcept { return law_state_; }

 private:
  using Equations = LoopEquations<S, Law, N>;
  using Instant = typename Equations::Instant;
  using Instants = typename Equations::Instants;

  void evaluate() noexcept { equations_.evaluate(state_, typename Equations::LawStage{&law_state_}, now_); }

  /// Ends a step: the new state where it is good, the old one where the lane stops or has stopped.
  void commit(double h, const Instants& k) noexcept {
    S nearest;
    const WorldState<S, N> next = equations_.after(state_, h, k, nearest);
    ++steps_;
    record_.judge(next, nearest);
    const Mask<S> active = record_.running();
    equations_.advance(law_state_, h, k, active);
    replace(state_, next, active);
  }

  const Parameters& p_;
  Equations equations_;
  WorldState<S, N> state_;
  LawState law_state_;
  LoopRecord<S, N> record_;
  Instant now_;
  long long steps_ = 0;
};

}  // namespace hexservo
