#include "workers.hpp"

#include <algorithm>
#include <chrono>
#include <condition_variable>
#include <exception>
#include <mutex>
#include <thread>
#include <vector>

namespace hexservo::detail {

namespace {

constexpr std::chrono::milliseconds kWatchEvery{50};

}  // namespace

void run_blocks(std::size_t blocks, int threads, StopFlag& stop, const std::function<void(std::size_t)>& work,
                const std::function<bool()>& watch) {
  if (blocks == 0) return;
  std::atomic<std::size_t> next{0};
  std::mutex mutex;  // guards what follows
  std::condition_variable ended;
  std::size_t at_work = 0;
  std::exception_ptr error;

  const auto fail = [&] {
    const std::lock_guard lock(mutex);
    if (!error) error = std::current_exception();
    stop = true;
  };
  const auto worker = [&] {
    try {
      while (!stop) {
        const std::size_t block = next++;
        if (block >= blocks) break;
        work(block);
      }
    } catch (...) {
      fail();
    }
    const std::lock_guard lock(mutex);
    --at_work;
    ended.notify_one();
  };

  std::vector<std::thread> workers;
  const std::size_t wanted = std::min(blocks, static_cast<std::size_t>(std::max(threads, 1)));
  workers.reserve(wanted);
  at_work = wanted;
  while (workers.size() < wanted) {
    try {
      workers.emplace_back(worker);
    } catch (...) {  // the system gives no more threads or memory: go on with those that there are
      if (workers.empty()) throw;
      const std::lock_guard lock(mutex);
      at_work -= wanted - workers.size();
      break;
    }
  }

  for (std::unique_lock lock(mutex); at_work > 0;) {
    ended.wait_for(lock, kWatchEvery, [&] { return at_work == 0; });
    if (at_work == 0 || stop) break;
    lock.unlock();
    try {
      if (watch()) stop = true;
    } catch (...) {
      fail();
    }
    lock.lock();
  }
  for (std::thread& thread : workers) thread.join();
  if (error) std::rethrow_exception(error);
}

}  // namespace hexservo::detail
