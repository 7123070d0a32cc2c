/// @file
/// The run loop of a kernel, for one law and mode. Those of all laws are compiled together, which takes little longer
/// than one, with bounds on what is inlined that are wide enough for all of them (kernel_options in CMakeLists.txt).
#pragma once

#include "flatten.hpp"
#include "hexservo/closed_loop.hpp"
#include "hexservo/sampled_loop.hpp"
#include "hexservo/subnormals.hpp"
#include "kernel_lanes.hpp"
#include "weight_rows.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <optional>
#include <stdexcept>

namespace hexservo::detail {

template <class S, int N>
void write(const Vector<S, N>& values, int lane, double* to) {
  for (int i = 0; i < N; ++i) to[i] = of_lane(values(i), lane);
}

/// Writes each quantity of one lane's sample to its own place; what lies behind the points of the target is left out.
template <class S, int N, class Place>
void write_sample(const Sample<S, N>& sample, int points, int lane, Place&& place) {
  std::size_t quantity = 0;
  Sample<S, N>::visit(
      [&]<int M>(const char*, const Vector<S, M>& values) {
        double* to = place(quantity);
        const int count = N == kPoints ? M : sample_width(quantity, points);
        for (int i = 0; i < count; ++i) to[i] = of_lane(values(i), lane);
        ++quantity;
      },
      sample);
}

/// The parameters of all lanes; those without a scenario repeat the last one.
/// @throws std::invalid_argument where scenarios differ in what a pack shares
template <class S, class Law, int N>
void read_parameters(LoopParameters<S, Law, N>& parameters, const RunRequest& request) {
  parameters.recorded = request.recorded;
  parameters.recorded_target = request.recorded_target;
  parameters.measured = MetricGroups(request.unmeasured);
  parameters.samples_legs = request.log_every > 0;
  if constexpr (kLanes<S> == 1) {
    unflatten(parameters, request.parameters[0]);
  } else {
    LoopParameters<double, Law, N> scenario;
    for (int lane = 0; lane < kLanes<S>; ++lane) {
      unflatten(scenario, request.parameters[std::min(lane, request.count - 1)]);
      set_lane(parameters, lane, scenario);
    }
  }
}

/// Rows of the logs of all lanes; a lane that has stopped adds none.
template <class S, class LawState, int N = kPoints>
class Log {
 public:
  /// @param record, law_state of the loop, which must outlive this
  Log(const RunRequest& request, const LoopRecord<S, N>& record, const LawState& law_state)
      : request_(request), record_(record), law_state_(law_state) {
    for (int lane = 0; lane < request.count; ++lane) {
      answer(lane).rows = 0;
      has_weights_ = has_weights_ || answer(lane).weight_rows != nullptr;
    }
    note_weights();
    add();
  }

  /// After every step, where weights are asked for: those of the lanes that run go to the place of the next row.
  ///
  /// A lane that the end of a step stops has advanced its weights beyond its last good sample, which may become a row.
  void note_weights() {
    if (!has_weights_) return;
    const Mask<S> running = record_.running();
    for (int lane = 0; lane < request_.count; ++lane) {
      const RunAnswer& a = answer(lane);
      if (a.weight_rows != nullptr && of_lane(running, lane))
        write_weights(law_state_, lane, a.weight_rows + a.rows * kWeightNumbers);
    }
  }

  /// The sample of now, of the lanes that run.
  void add() {
    const Mask<S> running = record_.running();
    for (int lane = 0; lane < request_.count; ++lane)
      if (of_lane(running, lane)) add(lane);
  }

  /// The last good sample, where it is not the last row already.
  void end(int lane) {
    const RunAnswer& a = answer(lane);
    if (a.rows == 0 || last_time_[static_cast<std::size_t>(lane)] != of_lane(record_.sample_time(), lane)) add(lane);
  }

 private:
  RunAnswer& answer(int lane) { return request_.answers[lane]; }

  void add(int lane) {
    RunAnswer& a = answer(lane);
    const double time = of_lane(record_.sample_time(), lane);
    if (a.time != nullptr) a.time[a.rows] = time;
    write_sample(record_.sample(), request_.points, lane, [&](std::size_t quantity) {
      return a.columns[quantity] + a.rows * sample_width(quantity, request_.points);
    });
    last_time_[static_cast<std::size_t>(lane)] = time;
    ++a.rows;
  }

  const RunRequest& request_;
  const LoopRecord<S, N>& record_;
  const LawState& law_state_;
  bool has_weights_ = false;
  std::array<double, static_cast<std::size_t>(kLanes<S>)> last_time_{};
};

/// Fills in one lane's answer, but for the weights.
template <class S, int N>
void answer(const LoopRecord<S, N>& record, const S& steps, bool stopped, int lane, const RunRequest& request) {
  RunAnswer& a = request.answers[lane];
  double* next = a.sample;
  write_sample(record.sample(), request.points, lane, [&](std::size_t quantity) {
    double* place = next;
    next += sample_width(quantity, request.points);
    return place;
  });
  const Metrics<S> metrics = record.metrics().metrics();
  next = a.metrics;
  Metrics<S>::visit([&](const char*, const S& value) { *next++ = of_lane(value, lane); }, metrics);
  const auto limit = [lane](const LegLimitMonitor<S>& monitor, double* first_time, double* peak) {
    write(monitor.first_time, lane, first_time);
    write(monitor.peak, lane, peak);
  };
  limit(record.metrics().stroke(), a.stroke_first_time, a.stroke_peak);
  limit(record.metrics().force(), a.force_first_time, a.force_peak);
  limit(record.metrics().speed(), a.speed_first_time, a.speed_peak);
  limit(record.metrics().base_joint(), a.base_joint_first_time, a.base_joint_peak);
  limit(record.metrics().platform_joint(), a.platform_joint_first_time, a.platform_joint_peak);
  a.end_time = of_lane(record.sample_time(), lane);
  a.steps = static_cast<long long>(of_lane(steps, lane));
  a.cause = static_cast<int>(of_lane(record.cause(), lane));
  // Numbers so large that a sum or a square of theirs overflows are finite one by one.
  if (a.cause == static_cast<int>(StopCause::none) &&
      std::any_of(a.metrics, next, [](double m) { return std::isinf(m); }))
    a.cause = static_cast<int>(StopCause::not_finite);
  a.limit_leg = static_cast<int>(of_lane(record.limit_leg(), lane));
  a.limit_value = of_lane(record.limit_value(), lane);
  a.interrupted = stopped && a.cause == static_cast<int>(StopCause::none) && a.steps < request.steps;
}

template <class S, class LawState, int N>
void answer(const LoopRecord<S, N>& record, const LawState& law_state, const S& steps, bool stopped, int lane,
            const RunRequest& request) {
  answer(record, steps, stopped, lane, request);
  const RunAnswer& a = request.answers[lane];
  if (a.weights != nullptr) write_weights(law_state, lane, a.weights);
}

/// Whether the caller requests the end of the run; it may run any code, in its own thread's mode.
inline bool is_stopped(const RunRequest& request, long long steps) {
  const KeepSubnormals keep;
  return request.stop(request.context, steps);
}

/// The one run loop: all lanes to their end, each stopping by itself.
template <class Loop, class S, class Law, int N>
RunStatus run(const RunRequest& request) {
  LoopParameters<S, Law, N> parameters;
  if (request.numbers != flat_size(LoopParameters<double, Law, N>{})) return RunStatus::other_layout;
  try {
    read_parameters(parameters, request);
  } catch (const std::invalid_argument&) {
    return RunStatus::not_uniform;
  }

  Loop loop(parameters);
  const LoopRecord<S, N>& record = loop.record();
  const bool logging = request.log_every > 0;
  std::optional<Log<S, typename Loop::LawState, N>> log;
  if (logging) log.emplace(request, record, loop.law_state());
  S steps(0.0);  // that each lane has taken
  bool stopped = false;
  long long until_logged = request.log_every;
  long long until_asked = request.stop == nullptr ? 0 : 1;  // whether to stop
  while (loop.steps() < request.steps) {
    const Mask<S> running = record.running();
    if (!any(running)) break;
    if (--until_asked == 0) {
      until_asked = request.ask_every;
      stopped = is_stopped(request, loop.steps());
      if (stopped) break;
    }
    loop.advance();
    steps = select(running, S(static_cast<double>(loop.steps())), steps);
    if (!logging) continue;
    log->note_weights();
    if (--until_logged == 0) {
      until_logged = request.log_every;
      log->add();
    }
  }
  loop.finish();
  for (int lane = 0; lane < request.count; ++lane) {
    answer(record, loop.law_state(), steps, stopped, lane, request);
    const RunAnswer& a = request.answers[lane];
    const bool completed = a.cause == static_cast<int>(StopCause::none) && !a.interrupted;
    if (logging && (request.log_end || completed)) log->end(lane);
  }
  return RunStatus::done;
}

template <class S, class Law, int N>
RunStatus run_continuous(const RunRequest& request) {
  if constexpr (kTracks<Law>)
    return RunStatus::unknown_law;  // such a scenario is refused: the law lives on frames
  else
    return run<ClosedLoop<S, Law, N>, S, Law, N>(request);
}

template <class S, class Law, int N>
RunStatus run_sampled(const RunRequest& request) {
  return run<SampledLoop<S, Law, N>, S, Law, N>(request);
}

}  // namespace hexservo::detail
