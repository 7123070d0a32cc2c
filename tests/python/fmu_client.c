/* A program in C99 that runs an extracted unit of FMI 2.0, with the standard's own headers, and times it.
 *
 *   fmu_client LIBRARY TOKEN RESOURCES STEP COUNT FIRST OUTPUTS <scenario.txt
 *
 * Prints the outputs FIRST ... FIRST + OUTPUTS - 1 after COUNT steps as hexadecimal floats, then the least processor
 * times per step of several rounds [ns]: of the unit, step by step with these outputs read, and of the same run in one
 * call of the C interface.
 */
#define _POSIX_C_SOURCE 200809L
#include <dlfcn.h>
#include <fmi2FunctionTypes.h>
#include <hexservo.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#define ROUNDS 7

static void* library;

/* A pointer to a function, which ISO C does not make of the pointer that dlsym gives. */
#define FUNCTION(type, name) \
  type* name;                \
  *(void**)(&name) = dlsym(library, #name)

static void logger(fmi2ComponentEnvironment environment, fmi2String name, fmi2Status status, fmi2String category,
                   fmi2String message, ...) {
  va_list arguments;
  (void)environment, (void)status, (void)category;
  va_start(arguments, message);
  fprintf(stderr, "%s: ", name);
  vfprintf(stderr, message, arguments);
  va_end(arguments);
}

static double now(void) {
  struct timespec time;
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &time);
  return 1e9 * (double)time.tv_sec + (double)time.tv_nsec;
}

int main(int count, char** words) {
  const fmi2CallbackFunctions callbacks = {logger, calloc, free, NULL, NULL};
  hexservo_scenario* scenario;
  fmi2ValueReference references[256];
  double values[256], step, unit_time = 1e300, run_time = 1e300;
  long steps, i;
  size_t outputs, k;
  int round;
  char line[4096];
  if (count != 8 || (library = dlopen(words[1], RTLD_NOW | RTLD_LOCAL)) == NULL) return 2;
  {
    FUNCTION(fmi2InstantiateTYPE, fmi2Instantiate);
    FUNCTION(fmi2SetupExperimentTYPE, fmi2SetupExperiment);
    FUNCTION(fmi2EnterInitializationModeTYPE, fmi2EnterInitializationMode);
    FUNCTION(fmi2ExitInitializationModeTYPE, fmi2ExitInitializationMode);
    FUNCTION(fmi2DoStepTYPE, fmi2DoStep);
    FUNCTION(fmi2GetRealTYPE, fmi2GetReal);
    FUNCTION(fmi2ResetTYPE, fmi2Reset);
    FUNCTION(fmi2FreeInstanceTYPE, fmi2FreeInstance);
    fmi2Component unit = fmi2Instantiate("unit", fmi2CoSimulation, words[2], words[3], &callbacks, 0, 0);
    step = atof(words[4]);
    steps = atol(words[5]);
    outputs = (size_t)atol(words[7]);
    if (unit == NULL || outputs > 256) return 3;
    for (k = 0; k < outputs; ++k) references[k] = (fmi2ValueReference)((size_t)atol(words[6]) + k);
    scenario = hexservo_scenario_create();
    while (fgets(line, sizeof line, stdin) != NULL) {
      char* space = strchr(line, ' ');
      if (space == NULL) break;
      *space = '\0';
      line[strlen(line) + 1 + strcspn(space + 1, "\n")] = '\0';
      if (hexservo_scenario_set_text(scenario, line, space + 1) != HEXSERVO_OK) return 4;
    }
    for (round = 0; round < ROUNDS; ++round) {
      hexservo_run* run;
      double start;
      if (fmi2Reset(unit) != fmi2OK || fmi2SetupExperiment(unit, 0, 0.0, 0.0, 0, 0.0) != fmi2OK ||
          fmi2EnterInitializationMode(unit) != fmi2OK || fmi2ExitInitializationMode(unit) != fmi2OK)
        return 5;
      start = now();
      for (i = 0; i < steps; ++i)
        if (fmi2DoStep(unit, (double)i * step, step, fmi2True) != fmi2OK ||
            fmi2GetReal(unit, references, outputs, values) != fmi2OK)
          return 6;
      start = (now() - start) / (double)steps;
      unit_time = start < unit_time ? start : unit_time;
      if (hexservo_run_create(scenario, &run) != HEXSERVO_OK) return 7;
      start = now();
      hexservo_run_advance(run, steps);
      start = (now() - start) / (double)steps;
      run_time = start < run_time ? start : run_time;
      hexservo_run_destroy(run);
    }
    fmi2FreeInstance(unit);
  }
  for (k = 0; k < outputs; ++k) printf("%a ", values[k]);
  printf("\n%.1f %.1f\n", unit_time, run_time);
  hexservo_scenario_destroy(scenario);
  return 0;
}
