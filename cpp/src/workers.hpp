/// @file
/// Work in numbered blocks on threads, while the calling thread looks after Ctrl-C and progress.
#pragma once

#include <atomic>
#include <cstddef>
#include <functional>

namespace hexservo::detail {

/// A question for all workers: true once the batch is to end.
using StopFlag = std::atomic<bool>;

/// Runs `work(block)` for every block from 0 up on `threads` threads, and `watch` in the calling thread every 50 ms.
///
/// Blocks start in their order. Where `stop` is set no further block starts. What `work` or `watch` throws first ends
/// everything and is thrown again here, after all threads have ended.
/// @param watch true: set `stop`
void run_blocks(std::size_t blocks, int threads, StopFlag& stop, const std::function<void(std::size_t)>& work,
                const std::function<bool()>& watch);

}  // namespace hexservo::detail
