/* A program in C99: reads lines "key value", runs the scenario, joins its plant and its controller, ticks the
 * controller, and prints every number.
 *
 *   c_client TICKS <scenario.txt: "run" with all samples and metrics, a line on the plant, "tick" lines; numbers as
 * hexadecimal floats
 */
#include <hexservo.h>

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* Counts what is taken from the heap, by the library too. */
static unsigned long taken = 0;
#if defined(__GLIBC__) && !defined(__SANITIZE_ADDRESS__) && \
    !defined(__SANITIZE_THREAD__) /* these have their own heap */
#define COUNTS
extern void* __libc_malloc(size_t size);
void* malloc(size_t size) {
  ++taken;
  return __libc_malloc(size);
}
#endif

static int fail(const hexservo_scenario* scenario) {
  fprintf(stderr, "%s\n", hexservo_scenario_message(scenario));
  return 2;
}

static void print(const char* name, const double* numbers, size_t count) {
  size_t i;
  printf("%s", name);
  for (i = 0; i < count; ++i) printf(" %a", numbers[i]);
  printf("\n");
}

static int run(hexservo_scenario* scenario) {
  hexservo_run* run;
  int quantity;
  size_t index;
  hexservo_limit_event event;
  if (hexservo_run_create(scenario, &run) != HEXSERVO_OK) return fail(scenario);
  while (hexservo_run_outcome(run) == HEXSERVO_RUNNING) hexservo_run_advance(run, 777);
  printf("outcome %s\n", hexservo_outcome_name(hexservo_run_outcome(run)));
  for (quantity = HEXSERVO_TIME; hexservo_run_width(run, (hexservo_quantity)quantity) > 0; ++quantity)
    print("samples", hexservo_run_samples(run, (hexservo_quantity)quantity),
          hexservo_run_rows(run) * hexservo_run_width(run, (hexservo_quantity)quantity));
  print("metrics", hexservo_run_metrics(run), hexservo_metric_count());
  for (index = 0; hexservo_run_event(run, index, &event); ++index)
    printf("event %d %d %a %a %a\n", (int)event.limit, event.leg, event.first_time, event.peak, event.largest);
  if (index != hexservo_run_event_count(run)) return 8;
  hexservo_run_destroy(run);
  return 0;
}

/* Plant and controller, joined here, against the run of both: prints how many ticks are equal in every bit. */
static int joined(hexservo_scenario* scenario) {
  static const hexservo_quantity compared[] = {HEXSERVO_TIME, HEXSERVO_FEATURE_ERROR, HEXSERVO_POSITION,
                                               HEXSERVO_LEG_FORCES};
  static hexservo_gains_memory gains_memory;
  static hexservo_state_memory state_memory; /* with the poses of frames under way */
  unsigned long before;
  hexservo_run* run;
  hexservo_plant* plant;
  hexservo_gains* gains;
  hexservo_state* state;
  hexservo_input input;
  hexservo_output output;
  size_t row, rows, width, i;
  int equal = 1, goes_on = 1;
  if (hexservo_plant_create(scenario, &plant) != HEXSERVO_OK) {
    printf("%s\n", hexservo_scenario_message(scenario));
    return 0;
  }
  if (hexservo_scenario_set_number(scenario, "simulation.log_every", 1.0) != HEXSERVO_OK ||
      hexservo_run_create(scenario, &run) != HEXSERVO_OK ||
      hexservo_gains_place(scenario, 0.0, &gains_memory, sizeof gains_memory, &gains) != HEXSERVO_OK)
    return fail(scenario);
  hexservo_run_advance(run, -1);
  rows = hexservo_run_rows(run);
  before = taken;
  state = hexservo_state_place(gains, &state_memory, sizeof state_memory);
  if (state == NULL || taken != before) return 6;
  for (row = 0; row < rows && goes_on; ++row) {
    hexservo_plant_sense(plant, &input);
    hexservo_tick(gains, state, &input, &output);
    /* NaN where the drives take forces */
    goes_on = hexservo_plant_command(plant, isnan(output.leg_positions[0]) ? output.wrench : output.leg_positions);
    for (i = 0; i < sizeof compared / sizeof *compared; ++i) {
      width = hexservo_run_width(run, compared[i]);
      equal &= memcmp(hexservo_plant_newest(plant, compared[i]), hexservo_run_samples(run, compared[i]) + row * width,
                      width * sizeof(double)) == 0;
    }
    if (!equal) break;
  }
  printf("%d of %d ticks are equal\n", (int)row, (int)rows);
  hexservo_plant_destroy(plant);
  hexservo_run_destroy(run);
  return 0;
}

/* Sensors that see the platform move about home: any numbers will do, as long as Python makes the same. */
static int tick(hexservo_scenario* scenario, long ticks) {
  static char memory[1 << 20]; /* all that the controller needs */
  size_t room;
  hexservo_gains* gains;
  hexservo_state* state;
  hexservo_input input;
  hexservo_output output, without[3];
  double *features, *depth, sum[18] = {0};
  size_t points, count, i;
  unsigned long before;
  long k;
  room = hexservo_gains_size(scenario);
  if (hexservo_gains_place(scenario, 0.0, memory + 1, room - 1, &gains) != HEXSERVO_REFUSED || gains != NULL) return 6;
  if (room > sizeof memory - 1) return 6;
  if (hexservo_gains_place(scenario, 0.0, memory + 1, room, &gains) != HEXSERVO_OK) return fail(scenario);
  points = hexservo_gains_points(gains);
  features = malloc(2 * points * sizeof *features);
  depth = malloc(points * sizeof *depth);
  if (features == NULL || depth == NULL) return 3;
  before = taken;
  state = hexservo_state_create(gains);
  if (state == NULL) return 3;
#ifdef COUNTS
  if (taken == before) return 3; /* it counts */
#endif
  hexservo_state_destroy(state);
  count = hexservo_state_size(gains);
  if (count > sizeof memory - 1 - room || hexservo_state_place(gains, memory + 1 + room, count / 2) != NULL) return 6;
  before = taken;
  state = hexservo_state_place(gains, memory + 1 + room, count);
  if (state == NULL || taken != before) return 6;
  if (hexservo_scenario_get_numbers(scenario, "target.initial_features", features, 2 * points, &count) != HEXSERVO_OK)
    return fail(scenario);
  hexservo_input_clear(&input);
  input.features = features;
  input.depth = depth;
  for (i = 0; i < points; ++i) depth[i] = -0.5;
  for (i = 0; i < 6; ++i) input.twist[i] = 0.0;
  input.position[0] = input.position[1] = 0.0;
  input.position[2] = -0.15;
  input.quaternion[0] = 1.0;
  input.quaternion[1] = input.quaternion[2] = input.quaternion[3] = 0.0;
  for (k = 0; k < ticks; ++k) {
    const double sway = (double)(k % 1000 - 500) / 1048576.0;
    input.now = input.exposure = (double)k * hexservo_gains_period(gains);
    features[0] += sway;
    input.position[1] = sway;
    input.twist[0] = 2.0 * sway;
    before = taken;
    hexservo_tick(gains, state, &input, &output);
    if (taken != before) return 5;
    if (output.status != HEXSERVO_VALID) return 4;
    for (i = 0; i < 6; ++i) {
      sum[i] = 0.5 * sum[i] + output.wrench[i];
      sum[6 + i] = 0.5 * sum[6 + i] + output.leg_forces[i];
      sum[12 + i] = 0.5 * sum[12 + i] + output.fuzzy_output[i];
    }
    if (k % 100 == 99) print("tick", sum, 18);
  }
  /* An input without features has no frame, whatever its exposure; features without depths are not to be used. */
  for (i = 0; ticks > 0 && i < 3; ++i) {
    state = hexservo_state_create(gains);
    if (state == NULL) return 3;
    input.features = features;
    input.depth = depth;
    input.now = input.exposure = 0.0;
    hexservo_tick(gains, state, &input, &output);
    if (i < 2) input.features = NULL;
    input.depth = NULL;
    input.now = hexservo_gains_period(gains);
    input.exposure = i == 0 ? NAN : input.now;
    hexservo_tick(gains, state, &input, &without[i]);
    hexservo_state_destroy(state);
    if (without[i].status != (i < 2 ? HEXSERVO_VALID : HEXSERVO_UNUSABLE)) return 7;
  }
  if (ticks > 0 && memcmp(without[0].wrench, without[1].wrench, sizeof output.wrench) != 0) return 7;
  free(features);
  free(depth);
  return 0;
}

int main(int argc, char** argv) {
  char line[4096];
  int code = 0;
  hexservo_scenario* scenario = hexservo_scenario_create();
  if (scenario == NULL || argc != 2) return 3;
  if (hexservo_interface() != HEXSERVO_INTERFACE) {
    fprintf(stderr, "hexservo.h: expected interface %d, got %d\n", HEXSERVO_INTERFACE, hexservo_interface());
    return 3;
  }
  while (code == 0 && fgets(line, sizeof line, stdin) != NULL) {
    char* value = strchr(line, ' ');
    line[strcspn(line, "\n")] = '\0';
    if (value == NULL) return 3;
    *value++ = '\0';
    if (hexservo_scenario_set_text(scenario, line, value) != HEXSERVO_OK) code = fail(scenario);
  }
  if (code == 0) code = run(scenario);
  if (code == 0) code = joined(scenario);
  if (code == 0) code = tick(scenario, atol(argv[1]));
  hexservo_scenario_destroy(scenario);
  return code;
}
