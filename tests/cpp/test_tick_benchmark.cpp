// The timing of ticks: nothing allocated between two, every tick counted, stopped on request, the system put back.
#include "hexservo/tick_benchmark.hpp"

#include "allocations.hpp"
#include "scenarios.hpp"

#include <doctest/doctest.h>

#include <algorithm>
#include <string>
#include <utility>
#include <vector>

namespace {

using namespace hexservo;

/// Allocations that the program had made at each question, which is asked between two ticks.
struct Watch {
  std::vector<long long> allocations;

  Watch() { allocations.reserve(10'000); }

  auto question() {
    return [this] {
      if (allocations.size() < allocations.capacity()) allocations.push_back(test::allocations);
      return false;
    };
  }
};

Settings settings() {
  Settings s = test::paper_settings();
  s.simulation.duration = 0.5;
  return s;
}

}  // namespace

TEST_CASE("nothing is allocated from tick to tick, with a clock and without one") {
  for (const auto& [periods, rate] : {std::pair{200'000LL, 0.0}, std::pair{400LL, 1000.0}}) {
    CAPTURE(rate);
    Watch watch;
    const TickTimes times = time_ticks(settings(), {periods, rate, false, watch.question()});
    CHECK(times.periods == periods);
    CHECK_FALSE(times.interrupted);
    REQUIRE(watch.allocations.size() >= 3);
    CHECK(watch.allocations.front() > 0);
    CHECK(watch.allocations.front() == watch.allocations.back());
  }
}

TEST_CASE("a stop request ends the benchmark, and the ticks timed so far are kept") {
  for (const double rate : {0.0, 1000.0}) {
    int questions = 0;
    const auto second = [&questions] { return ++questions == 2; };
    const TickTimes times = time_ticks(settings(), {1'000'000, rate, false, second});
    CHECK(times.interrupted);
    CHECK(times.latency.size() > 0);
    CHECK(times.periods < 1'000'000);
    CHECK(times.lateness.size() == (rate > 0.0 ? times.latency.size() : 0));
  }
}

TEST_CASE("every tick counts: replays repeat themselves, none refuses its input") {
  const TickTimes times = time_ticks(settings(), {5'000, 0.0, false, {}});
  CHECK(times.latency.size() == 5'000);
  CHECK(std::all_of(times.latency.begin(), times.latency.end(), [](std::uint32_t time) { return time > 0; }));
  CHECK(times.reproduced);
  CHECK(times.invalid == 0);
  CHECK(times.missed == 0);
  CHECK(times.wrench_difference < 5e-4);
}

TEST_CASE("the real-time scheduling obtained is reported, and is restored afterwards") {
  const TickTimes asked = time_ticks(settings(), {100, 0.0, true, {}});
  CHECK(asked.scheduling.rfind("SCHED_FIFO", 0) == 0);
  CHECK(asked.memory.find("lock") != std::string::npos);
  const TickTimes after = time_ticks(settings(), {100, 0.0, false, {}});
  CHECK(after.scheduling == "not asked for");
  CHECK(after.memory == "not locked");
}
