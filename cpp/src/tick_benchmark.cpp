#include "hexservo/tick_benchmark.hpp"

#include "check.hpp"
#include "hexservo/subnormals.hpp"

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <limits>
#include <optional>

#include <pthread.h>
#include <sched.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <time.h>

namespace hexservo {

using detail::refuse;
using detail::words;

namespace {

constexpr long long kSecond = 1'000'000'000;                // [ns]
constexpr long long kBetweenQuestions = kSecond / 50;       // [ns] between two looks at Ctrl-C
constexpr long long kTicksBetweenQuestions = 1 << 14;       // the same for ticks without a clock
constexpr long long kTimeToFirstTick = 2 * kSecond / 1000;  // [ns]
constexpr long long kMaxRecorded = 1'000'000;               // steps
constexpr int kPriority = 80;  // above what usually runs with SCHED_FIFO, below the kernel's

long long now() noexcept {
  timespec t;
  clock_gettime(CLOCK_MONOTONIC, &t);
  return static_cast<long long>(t.tv_sec) * kSecond + t.tv_nsec;
}

void sleep_until(long long time) noexcept {
  timespec t;
  t.tv_sec = static_cast<time_t>(time / kSecond);
  t.tv_nsec = static_cast<long>(time % kSecond);
  while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &t, nullptr) == EINTR) {
  }
}

std::uint32_t limited(long long nanoseconds) noexcept {
  return static_cast<std::uint32_t>(std::clamp<long long>(nanoseconds, 0, std::numeric_limits<std::uint32_t>::max()));
}

double clock_cost() {
  std::vector<long long> costs(2001);
  for (long long& cost : costs) {
    const long long start = now();
    cost = now() - start;
  }
  const auto middle = costs.begin() + static_cast<std::ptrdiff_t>(costs.size() / 2);
  std::nth_element(costs.begin(), middle, costs.end());
  return static_cast<double>(*middle);
}

/// Wakes this thread as exactly as the system can, with SCHED_FIFO and locked memory where that is asked for; puts
/// everything back in the end.
class Scheduling {
 public:
  Scheduling(bool realtime, TickTimes& times) : slack_(prctl(PR_GET_TIMERSLACK)) {
    prctl(PR_SET_TIMERSLACK, 1UL);  // by default a wake-up may wait 50 us for company
    pthread_getschedparam(pthread_self(), &policy_, &parameters_);
    times.scheduling = policy_ == SCHED_FIFO ? "SCHED_FIFO already" : "not asked for";
    times.memory = "not locked";
    if (!realtime) return;
    sched_param wanted{};
    wanted.sched_priority = kPriority;
    const int error = pthread_setschedparam(pthread_self(), SCHED_FIFO, &wanted);
    changed_ = error == 0;
    times.scheduling = changed_ ? words("SCHED_FIFO, priority ", kPriority)
                                : words("SCHED_FIFO not granted (", std::strerror(error), ")");
    locked_ = mlockall(MCL_CURRENT | MCL_FUTURE) == 0;
    times.memory = locked_ ? "locked" : words("locking not granted (", std::strerror(errno), ")");
  }

  ~Scheduling() {
    if (locked_) munlockall();
    if (changed_) pthread_setschedparam(pthread_self(), policy_, &parameters_);
    if (slack_ > 0) prctl(PR_SET_TIMERSLACK, static_cast<unsigned long>(slack_));
  }

  Scheduling(const Scheduling&) = delete;
  Scheduling& operator=(const Scheduling&) = delete;

 private:
  int slack_;
  int policy_ = SCHED_OTHER;
  sched_param parameters_{};
  bool changed_ = false, locked_ = false;
};

/// What the sensors gave in a run, and the wrench that answered it.
template <int N>
struct Recording {
  std::vector<ControllerInputOf<N>> inputs;
  std::vector<Vector6<double>> wrenches;
};

template <class Law, int N>
Recording<N> record(const Settings& settings) {
  const LoopParameters<double, Law, N> parameters = loop_parameters<Law, N>(settings);
  const long long steps = step_count(settings.simulation);
  if (steps > kMaxRecorded)
    refuse("simulation.duration", words("a run of at most ", kMaxRecorded, " steps to replay"), words(steps, " steps"));
  Recording<N> recording;
  recording.inputs.reserve(static_cast<std::size_t>(steps));
  recording.wrenches.reserve(static_cast<std::size_t>(steps));
  ClosedLoop<double, Law, N> loop(parameters);
  for (long long i = 0; i < steps && loop.record().running(); ++i) {
    recording.inputs.push_back(input_of(loop.time(), loop.observe()));
    recording.wrenches.push_back(loop.record().sample().wrench);
    loop.advance();
  }
  if (!loop.record().running()) refuse("scenario", "a run that goes to its end, to replay", "one that stops");
  return recording;
}

/// Replays a recording endlessly, and watches the answers between the ticks.
template <class Law, int N>
class Replay {
 public:
  Replay(const ControllerGains<Law, N>& gains, const Recording<N>& recording, TickTimes& times)
      : gains_(gains), recording_(recording), times_(times), state_(initial_state(gains)) {
    for (std::size_t i = 0; i < recording.inputs.size(); ++i) {  // warms up, and is what later replays must repeat
      tick();
      const double difference = (output_.wrench - recording.wrenches[i]).cwiseAbs().maxCoeff();
      times.wrench_difference = std::max(times.wrench_difference, difference);
      check();
    }
  }

  /// What is timed.
  void tick() noexcept { output_ = step(gains_, state_, recording_.inputs[next_]); }

  /// What is not timed.
  void check() noexcept {
    sum_ += output_.wrench + output_.leg_forces;
    times_.invalid += output_.invalid_input();
    if (++next_ < recording_.inputs.size()) return;
    if (!expected_) expected_ = sum_;
    times_.reproduced = times_.reproduced && sum_ == *expected_;
    next_ = 0;
    sum_.setZero();
    state_ = start_;
  }

 private:
  const ControllerGains<Law, N>& gains_;
  const Recording<N>& recording_;
  TickTimes& times_;
  ControllerState<Law, N> state_;
  const ControllerState<Law, N> start_ = state_;
  ControllerOutput output_{};
  std::size_t next_ = 0;
  Vector6<double> sum_ = Vector6<double>::Zero();  ///< of a replay's outputs, always in the same order
  std::optional<Vector6<double>> expected_;
};

/// One tick after another.
template <class Law, int N>
void run_free(Replay<Law, N>& replay, const TickBenchmarkOptions& options, TickTimes& times) {
  while (times.periods < options.periods) {
    if (times.periods % kTicksBetweenQuestions == 0 && options.stop_requested && options.stop_requested()) {
      times.interrupted = true;
      return;
    }
    const long long start = now();
    replay.tick();
    const long long end = now();
    times.latency.push_back(limited(end - start));
    ++times.periods;
    replay.check();
  }
}

/// A tick per period of an absolute clock.
template <class Law, int N>
void run_paced(Replay<Law, N>& replay, const TickBenchmarkOptions& options, TickTimes& times) {
  const long long begin = now() + kTimeToFirstTick;
  const auto time_of = [&](long long period) {
    return begin + std::llround(static_cast<double>(period) * (static_cast<double>(kSecond) / options.rate));
  };
  long long asked = begin;
  while (times.periods < options.periods) {
    const long long planned = time_of(times.periods);
    sleep_until(planned);
    const long long start = now();
    replay.tick();
    const long long end = now();
    times.latency.push_back(limited(end - start));
    times.lateness.push_back(limited(start - planned));
    ++times.periods;
    replay.check();
    if (end > time_of(times.periods)) ++times.missed;
    // Periods that have passed meanwhile are lost: a robot has no use for yesterday's command.
    while (times.periods < options.periods && time_of(times.periods + 1) <= end) {
      ++times.periods;
      ++times.missed;
    }
    if (end - asked > kBetweenQuestions) {
      asked = end;
      if (options.stop_requested && options.stop_requested()) {
        times.interrupted = true;
        return;
      }
    }
  }
}

template <class Law, int N>
TickTimes time_ticks_of(const Settings& settings, const TickBenchmarkOptions& options) {
  const ControllerGains<Law, N> gains = controller_gains<Law, N>(settings);
  const Recording<N> recording = record<Law, N>(settings);
  TickTimes times;
  // Written once here, so that no tick meets a page that is not there yet.
  times.latency.assign(static_cast<std::size_t>(options.periods), 1);
  times.latency.clear();
  if (options.rate > 0.0) {
    times.lateness.assign(static_cast<std::size_t>(options.periods), 1);
    times.lateness.clear();
  }
  const Scheduling scheduling(options.realtime, times);
  const FlushSubnormals flush;  // as a thread that ticks would: a tick then only looks whether it is set
  times.clock_cost = clock_cost();
  Replay<Law, N> replay(gains, recording, times);
  options.rate > 0.0 ? run_paced(replay, options, times) : run_free(replay, options, times);
  return times;
}

}  // namespace

TickTimes time_ticks(const Settings& settings, const TickBenchmarkOptions& options) {
  if (options.periods < 1 || options.periods > kMaxTimedPeriods)
    refuse("ticks", words("a whole number from 1 to ", kMaxTimedPeriods), words(options.periods));
  if (!(options.rate >= 0.0 && options.rate <= kMaxTickRate))
    refuse("rate", words("0 or a rate of up to ", kMaxTickRate, " Hz"), words(options.rate));
  return with_loop(settings, [&]<class Law, int N>(std::type_identity<Law>, std::integral_constant<int, N>) {
    return time_ticks_of<Law, N>(settings, options);
  });
}

}  // namespace hexservo
