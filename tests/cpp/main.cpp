// The entry point of every C++ test program; each tests/cpp/test_*.cpp is linked with it on its own.
#define DOCTEST_CONFIG_IMPLEMENT_WITH_MAIN
#include <doctest/doctest.h>
