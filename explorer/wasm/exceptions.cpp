// How an exception leaves the module: as one of JavaScript, which unwinds everything up to the call from there.
//
// The core throws for a scenario that it refuses, and nowhere else; the system library for WebAssembly has no
// exceptions of its own. No destructor runs on the way, so a refusal loses the memory of the call it ends: the page
// makes a new instance after some of them (core.js).
#include <cstdlib>
#include <cstring>
#include <exception>
#include <typeinfo>

extern "C" {

__attribute__((import_module("hexservo"), import_name("refuse"))) void hexservo_refuse(const char* what, size_t size);

void* __cxa_allocate_exception(size_t size) noexcept { return std::malloc(size); }
void __cxa_free_exception(void* exception) noexcept { std::free(exception); }

/// Everything that the core and the standard library throw is a std::exception, first of its bases.
[[noreturn]] void __cxa_throw(void* exception, std::type_info* /*type*/, void (* /*destructor*/)(void*)) {
  const char* what = static_cast<std::exception*>(exception)->what();
  hexservo_refuse(what, std::strlen(what));
  __builtin_trap();
}
}
