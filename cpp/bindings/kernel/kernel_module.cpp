// A Python module that holds one kernel and nothing else: its attribute `kernel` is a capsule with the function table.
#define PY_SSIZE_T_CLEAN
#include <Python.h>

#include "../../src/kernel.hpp"

#define JOIN_NAMES(a, b) a##b
#define INIT_FUNCTION(module) JOIN_NAMES(PyInit_, module)
#define TEXT_OF_NAME(module) #module
#define TEXT(module) TEXT_OF_NAME(module)

PyMODINIT_FUNC INIT_FUNCTION(HEXSERVO_KERNEL_MODULE)() {
  static PyModuleDef definition = {};
  definition.m_base = PyModuleDef_HEAD_INIT;
  definition.m_name = "hexservo." TEXT(HEXSERVO_KERNEL_MODULE);
  definition.m_doc = "hexservo's run loop for one instruction set. Private.";
  definition.m_size = -1;
  PyObject* module = PyModule_Create(&definition);
  if (module == nullptr) return nullptr;
  // A capsule takes a pointer to non-const; nothing writes through it.
  auto* table = const_cast<hexservo::Kernel*>(&hexservo::built_in_kernel());
  PyObject* capsule = PyCapsule_New(table, hexservo::kKernelCapsule, nullptr);
  if (capsule == nullptr || PyModule_AddObject(module, "kernel", capsule) != 0) {
    Py_XDECREF(capsule);
    Py_DECREF(module);
    return nullptr;
  }
  return module;
}
