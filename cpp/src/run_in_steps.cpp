#include "run_in_steps.hpp"

#include "run_loop.hpp"

namespace hexservo::detail {

namespace {

template <template <class, class, int> class Loop, class Law, int N>
class RunOf final : public RunInSteps {
 public:
  RunOf(const Settings& given, const LoopParameters<double, Law, N>& p)
      : RunInSteps(given), parameters_(p), loop_(parameters_), rows_(request, loop_.record(), loop_.law_state()) {
    answer_now();
  }

  bool advance(long long count) override {
    const FlushSubnormals flush;
    const LoopRecord<double, N>& record = loop_.record();
    for (; count > 0 && loop_.steps() < request.steps && record.running(); --count) {
      loop_.advance();
      if (loop_.steps() % request.log_every == 0) rows_.add();
    }
    answer_now();
    if (loop_.steps() < request.steps && record.running()) return true;
    rows_.end(0);
    return false;
  }

  const Hexapod<double>& hexapod() const override { return parameters_.hexapod; }
  const CameraParameters<double>& camera() const override { return parameters_.camera; }
  void write_points(double* to) const override { std::copy_n(parameters_.points_T.data(), 3 * parameters_.points, to); }
  void write_goal(double* to) const override {
    std::copy_n(parameters_.desired_features.data(), 2 * parameters_.points, to);
  }

 private:
  void answer_now() {
    detail::answer(loop_.record(), loop_.law_state(), static_cast<double>(loop_.steps()), false, 0, request);
  }

  LoopParameters<double, Law, N> parameters_;
  Loop<double, Law, N> loop_;
  Log<double, typename Law::template State<double>, N> rows_;
};

}  // namespace

RunInSteps::RunInSteps(const Settings& given) : settings(given), log(settings.simulation, settings.target.count()) {
  request.count = 1;
  request.points = settings.target.count();
  request.steps = step_count(settings.simulation);
  request.log_every = settings.simulation.log_every;
  request.log_end = true;
  request.answers = &log.answer();
}

std::unique_ptr<RunInSteps> started(const Settings& settings) {
  return with_loop(
      settings,
      [&]<class Law, int N>(std::type_identity<Law>, std::integral_constant<int, N>) -> std::unique_ptr<RunInSteps> {
        // A recorded motion lives as long as the settings that the run keeps.
        const LoopParameters<double, Law, N> parameters = loop_parameters<Law, N>(settings);
        const FlushSubnormals flush;
        if (settings.simulation.mode == LoopMode::sampled)
          return std::make_unique<RunOf<SampledLoop, Law, N>>(settings, parameters);
        return std::make_unique<RunOf<ClosedLoop, Law, N>>(settings, parameters);
      });
}

}  // namespace hexservo::detail
