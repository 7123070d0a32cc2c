/// @file
/// What every kernel program of this folder speaks on standard input and output, so that run.py can drive several of
/// them in turns. A program is one separate executable per library; only text passes between them.
///
/// | command               | answer                                                        |
/// | --------------------- | ------------------------------------------------------------- |
/// | inputs ROWS, numbers  | nothing; takes ROWS x `columns` numbers                       |
/// | answers               | one line of numbers per row, from the state of a new start    |
/// | time ROUNDS           | nanoseconds per row, over ROUNDS passes through all rows      |
/// | version               | library, and the compiler of the program                      |
#pragma once

#include <chrono>
#include <cstddef>
#include <iomanip>
#include <iostream>
#include <string>
#include <vector>

namespace peers {

/// Kept so that no evaluation can be left out by the compiler.
inline volatile double sink = 0.0;

/// Reads a fixed number of doubles from standard input.
inline std::vector<double> read_numbers(std::size_t count) {
  std::vector<double> numbers(count);
  for (double& number : numbers) std::cin >> number;
  return numbers;
}

/// Answers commands until the input ends.
/// @param version name and version of the library
/// @param columns numbers per row of input
/// @param answers numbers per row of output
/// @param restart brings the evaluation back to its first state
/// @param evaluate (const double* row, double* out): evaluates one row
template <class Restart, class Evaluate>
int serve(const std::string& version, std::size_t columns, std::size_t answers, Restart&& restart,
          Evaluate&& evaluate) {
  std::vector<double> inputs, out(answers);
  std::size_t rows = 0;
  std::cout << std::setprecision(17);
  for (std::string command; std::cin >> command;) {
    if (command == "inputs") {
      std::cin >> rows;
      inputs = read_numbers(rows * columns);
    } else if (command == "answers") {
      restart();
      for (std::size_t row = 0; row < rows; ++row) {
        evaluate(&inputs[row * columns], out.data());
        for (const double number : out) std::cout << number << ' ';
        std::cout << '\n';
      }
    } else if (command == "time") {
      int rounds = 0;
      std::cin >> rounds;
      restart();
      const auto start = std::chrono::steady_clock::now();
      for (int round = 0; round < rounds; ++round) {
        for (std::size_t row = 0; row < rows; ++row) {
          evaluate(&inputs[row * columns], out.data());
          sink = out[0];
        }
      }
      const std::chrono::duration<double, std::nano> elapsed = std::chrono::steady_clock::now() - start;
      std::cout << elapsed.count() / (static_cast<double>(rounds) * static_cast<double>(rows)) << '\n';
    } else if (command == "version") {
      std::cout << version << "; g++ " << __VERSION__ << '\n';
    } else {
      std::cerr << "expected inputs, answers, time or version, got " << command << '\n';
      return 2;
    }
    std::cout.flush();
    if (!std::cin && !std::cin.eof()) {
      std::cerr << "expected a number after " << command << '\n';
      return 2;
    }
  }
  return 0;
}

}  // namespace peers
