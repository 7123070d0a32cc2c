/** @file
 * The C interface of hexservo: scenarios, runs, the controller's tick and plants (docs/c-interface.md).
 *
 * C99, and the one boundary under every language that is not C++. A scenario is set by the dotted keys of its file (but
 * for those that the Python package turns into others); which ones a law has, and what each takes, is asked
 * (`hexservo_scenario_key`), since all follow from one table.
 * `hexservo show NAME --flat` prints a scenario as lines `key value`, each of which `hexservo_scenario_set_text` takes.
 *
 *     hexservo_scenario* scenario = hexservo_scenario_create();
 *     hexservo_run* run;
 *     const char *start = "30 18 65 -65 -44 37 -10 -15", *goal = "10 10 45 -73 -64 29 -30 -23";
 *     if (hexservo_scenario_set_text(scenario, "target.initial_features", start) != HEXSERVO_OK ||
 *         hexservo_scenario_set_text(scenario, "target.desired_features", goal) != HEXSERVO_OK ||
 *         hexservo_scenario_set_number(scenario, "uncertainty.gravity", 0.075) != HEXSERVO_OK ||
 *         hexservo_run_create(scenario, &run) != HEXSERVO_OK) {
 *       puts(hexservo_scenario_message(scenario));
 *     } else {
 *       hexservo_run_advance(run, -1);
 *       printf("%s\n", hexservo_run_detail(run));
 *       hexservo_run_destroy(run);
 *     }
 *     hexservo_scenario_destroy(scenario);
 *
 * - SI units and radians; pixels in images. Frames and signs: docs/model.md. Matrices and samples lie row by row.
 * - No exception crosses, nothing is global: a message belongs to its scenario, a text to its handle. Different handles
 *   may be used by different threads at the same time, one handle by one thread at a time. What is const here may be
 *   shared by all.
 * - How many points a target has is asked (`hexservo_scenario_points`): do not count on four.
 * - Null is not allowed, but for `destroy` and where a parameter states it.
 */
#ifndef HEXSERVO_H
#define HEXSERVO_H

#include <stddef.h>
#include <stdint.h>

/** Changes with anything here that a program compiled before would misunderstand; see `hexservo_interface`. */
#define HEXSERVO_INTERFACE 3

#if defined(__GNUC__) || defined(__clang__)
#define HEXSERVO_API __attribute__((visibility("default")))
#else
#define HEXSERVO_API
#endif

#ifdef __cplusplus
extern "C" {
#endif

/** What a call came to. */
typedef enum hexservo_status {
  HEXSERVO_OK = 0,
  HEXSERVO_REFUSED = 1,  /**< "key: expected ..., got ..." is the scenario's message; nothing has changed */
  HEXSERVO_NO_MEMORY = 2 /**< likewise */
} hexservo_status;

/** `HEXSERVO_INTERFACE` of the library: a program that finds another one than its own should stop. */
HEXSERVO_API int hexservo_interface(void);
/** Version of the library, "major.minor.patch". */
HEXSERVO_API const char* hexservo_version(void);

/* --- scenarios ---------------------------------------------------------------------------------------------------- */

/** All that a run depends on, as numbers and names by key. */
typedef struct hexservo_scenario hexservo_scenario;

/** The core's defaults with the first law, of the paper's machine. Where the target's points look to be from the start
 * (`target.initial_features`, or `target.points`) and its goal (`target.desired_features`) have to be set. Null: no
 * memory. */
HEXSERVO_API hexservo_scenario* hexservo_scenario_create(void);
/** A copy, without the message. Null: no memory. */
HEXSERVO_API hexservo_scenario* hexservo_scenario_copy(const hexservo_scenario* scenario);
HEXSERVO_API void hexservo_scenario_destroy(hexservo_scenario* scenario);
/** Why the last call that had this scenario was refused; "" after one that was not. Holds until the next such call. */
HEXSERVO_API const char* hexservo_scenario_message(const hexservo_scenario* scenario);

/** What a key takes. */
typedef enum hexservo_type {
  HEXSERVO_NUMBER = 0,
  HEXSERVO_ARRAY = 1,   /**< `rows` by `columns` numbers */
  HEXSERVO_WHOLE = 2,   /**< a whole number */
  HEXSERVO_FLAG = 3,    /**< 1 or 0 */
  HEXSERVO_CHOICE = 4,  /**< one of several names: text alone */
  HEXSERVO_SAMPLES = 5, /**< rows of `columns` numbers, as many as there are */
  HEXSERVO_SEED = 6     /**< a whole number of 64 bits: text alone, for a double does not hold it */
} hexservo_type;

/** Description of a key; its texts live as long as the library. */
typedef struct hexservo_key {
  const char* name; /**< dotted: "camera.noise" */
  /** "px"; "linear; angular" where an array mixes both; "": none. What is of a leg is in rad and N m, in place of m and
   * N, where `robot.legs` is `rotary`. */
  const char* unit;
  hexservo_type type;
  int rows, columns;
  int optional;               /**< may be none: no numbers, or the text "none" */
  int sampled;                /**< acts in `sampled` mode alone */
  double minimum, maximum;    /**< of each number; infinite: no bound */
  int above, below;           /**< `minimum` itself is too small, `maximum` itself too large */
  size_t choice_count;        /**< of a choice */
  const char* const* choices; /**< their names */
} hexservo_key;

/** Number of keys that the scenario's law has. "controller.law" is one more, which texts alone set and get. */
HEXSERVO_API size_t hexservo_scenario_key_count(const hexservo_scenario* scenario);
/** Key `index`, in the order of a scenario file.
 * @return whether there is one */
HEXSERVO_API int hexservo_scenario_key(const hexservo_scenario* scenario, size_t index, hexservo_key* key);

/** Number of points of the target. */
HEXSERVO_API size_t hexservo_scenario_points(const hexservo_scenario* scenario);

/** Sets a key that holds numbers: all of them, where the key allows it one for all, or of a symmetric matrix the
 * diagonal.
 * @param count 0: none, of a key that is optional; no number stands for it
 * @return HEXSERVO_REFUSED for an unknown key or another count; bounds are checked by `hexservo_scenario_validate` */
HEXSERVO_API hexservo_status hexservo_scenario_set_numbers(hexservo_scenario* scenario, const char* key,
                                                           const double* numbers, size_t count);
/** The same with one number. */
HEXSERVO_API hexservo_status hexservo_scenario_set_number(hexservo_scenario* scenario, const char* key, double number);
/** Sets any key from text: a name, "none", or numbers with spaces between, always with a decimal point.
 *
 * "controller.law" keeps everything but the gains, which are then the defaults of the new law. */
HEXSERVO_API hexservo_status hexservo_scenario_set_text(hexservo_scenario* scenario, const char* key, const char* text);
/** Numbers of a key that holds some, row by row.
 * @param numbers room for `room` of them; null: only the count is asked for
 * @param count how many there are, which may be more than fit; 0: none; null: not asked for */
HEXSERVO_API hexservo_status hexservo_scenario_get_numbers(hexservo_scenario* scenario, const char* key,
                                                           double* numbers, size_t room, size_t* count);
/** Text of any key, as `hexservo_scenario_set_text` takes it; numbers read back bit for bit.
 * @param text null in case of an error; holds until the next call with this scenario */
HEXSERVO_API hexservo_status hexservo_scenario_get_text(hexservo_scenario* scenario, const char* key,
                                                        const char** text);
/** Checks all that a run checks before it starts. */
HEXSERVO_API hexservo_status hexservo_scenario_validate(hexservo_scenario* scenario);

/* --- runs --------------------------------------------------------------------------------------------------------- */

/** A simulation of a scenario, which it copies. */
typedef struct hexservo_run hexservo_run;

/** Starts a run; `simulation.log_every` says which steps are logged.
 * @param run null in case of an error */
HEXSERVO_API hexservo_status hexservo_run_create(hexservo_scenario* scenario, hexservo_run** run);
HEXSERVO_API void hexservo_run_destroy(hexservo_run* run);
/** Goes on by so many steps of `simulation.step`, or until it ends; a negative number: to its end.
 * @return steps that were taken since the start */
HEXSERVO_API int64_t hexservo_run_advance(hexservo_run* run, int64_t steps);

/** How a run ended. */
typedef enum hexservo_outcome {
  HEXSERVO_RUNNING = -1,
  HEXSERVO_COMPLETED = 0,
  HEXSERVO_DIVERGED = 1,
  HEXSERVO_BEHIND_CAMERA = 2,
  HEXSERVO_FEATURE_LOST = 3,
  HEXSERVO_LEG_LIMIT = 4,
  HEXSERVO_SINGULAR = 5,
  HEXSERVO_SOLVER_FAILED = 6
} hexservo_outcome;

HEXSERVO_API hexservo_outcome hexservo_run_outcome(const hexservo_run* run);
/** "running", "completed", "diverged", ... */
HEXSERVO_API const char* hexservo_outcome_name(hexservo_outcome outcome);
/** One sentence on how it ended; "" while it runs. */
HEXSERVO_API const char* hexservo_run_detail(const hexservo_run* run);
/** Time of the newest good sample [s]; a run that ends early ends a step later. */
HEXSERVO_API double hexservo_run_time(const hexservo_run* run);

/** What a sample consists of. */
typedef enum hexservo_quantity {
  HEXSERVO_TIME = 0,          /**< 1 [s] */
  HEXSERVO_FEATURE_ERROR = 1, /**< 2 per point, goal minus image, true [px] */
  HEXSERVO_DEPTH = 2,         /**< 1 per point, true Z, negative in front of the camera [m] */
  HEXSERVO_POSITION = 3,      /**< 3, of the platform in B [m] */
  HEXSERVO_QUATERNION = 4,    /**< 4, w x y z */
  HEXSERVO_TWIST = 5,         /**< 6, in B [m/s; rad/s] */
  HEXSERVO_WRENCH = 6,        /**< 6, in B [N; N m] */
  HEXSERVO_FUZZY_OUTPUT = 7,  /**< 6 [N; N m] */
  HEXSERVO_LEG_LENGTHS = 8,   /**< 6 [m] */
  HEXSERVO_LEG_FORCES = 9     /**< 6 [N], of cranks [N m] */
} hexservo_quantity;

/** Samples that were logged so far; after the end the last good one is among them. */
HEXSERVO_API size_t hexservo_run_rows(const hexservo_run* run);
/** Numbers of a quantity in each sample; 0: no such quantity. */
HEXSERVO_API size_t hexservo_run_width(const hexservo_run* run, hexservo_quantity quantity);
/** `hexservo_run_rows` times `hexservo_run_width` numbers, which stay where they are as long as the run exists. */
HEXSERVO_API const double* hexservo_run_samples(const hexservo_run* run, hexservo_quantity quantity);

/** The newest good sample, whether it is logged or not: `hexservo_run_width` numbers, which change with every step and
 * stay where they are as long as the run exists; null: no such quantity. */
HEXSERVO_API const double* hexservo_run_newest(const hexservo_run* run, hexservo_quantity quantity);

/** Number of metrics that a run has. */
HEXSERVO_API size_t hexservo_metric_count(void);
/** Name of metric `index`: "settling_time"; null: there is none. */
HEXSERVO_API const char* hexservo_metric_name(size_t index);
/** All metrics from the start until now; they do not depend on what is logged. NaN: not defined. */
HEXSERVO_API const double* hexservo_run_metrics(const hexservo_run* run);

/** What a leg was beyond. */
typedef enum hexservo_limit {
  HEXSERVO_STROKE = 0,        /**< |l - middle of the travel| [m], of cranks [rad] */
  HEXSERVO_FORCE = 1,         /**< |force| [N], of cranks [N m] */
  HEXSERVO_SPEED = 2,         /**< |rate| [m/s], of cranks [rad/s] */
  HEXSERVO_BASE_JOINT = 3,    /**< angle from its direction at home, at the base [rad] */
  HEXSERVO_PLATFORM_JOINT = 4 /**< likewise at the platform [rad] */
} hexservo_limit;

/** A leg beyond one of its limits. */
typedef struct hexservo_limit_event {
  hexservo_limit limit;
  int leg;           /**< 0 to 5 */
  double first_time; /**< [s] */
  double peak;       /**< largest value of the run, in the unit of the limit; of the event that ended it the last one */
  double largest;    /**< that the limit allows */
} hexservo_limit_event;

/** Number of limits that legs of a run passed, with the one that ended it, which is the last; 0 while it runs. */
HEXSERVO_API size_t hexservo_run_event_count(const hexservo_run* run);
/** Event `index`, in the order of first times, which do not depend on what is logged.
 * @return whether there is one */
HEXSERVO_API int hexservo_run_event(const hexservo_run* run, size_t index, hexservo_limit_event* event);

/** Where things are, for whoever draws them. */
typedef struct hexservo_scene {
  double base_joints[6][3];     /**< in B [m] */
  double platform_joints[6][3]; /**< in the platform's frame E [m] */
  double home_position[3];      /**< of E in B [m] */
  double home_quaternion[4];    /**< w x y z */
  double camera_position[3];    /**< true, in E, or in B where `camera_on_base` [m] */
  double camera_attitude[3][3]; /**< columns: axes of the camera in the same frame; it looks along its -z */
  double focal;                 /**< focal length [px] */
  int camera_on_base;           /**< 1: the camera is fixed in B, and the target's points in E (`camera.mount.on`) */
} hexservo_scene;

HEXSERVO_API void hexservo_run_scene(const hexservo_run* run, hexservo_scene* scene);
/** `hexservo_scenario_points` points of the target where they rest, x y z each, in B, or in E where
 * `camera_on_base` [m]. */
HEXSERVO_API void hexservo_run_target(const hexservo_run* run, double* points);
/** The goal, x y of each point as features of an ideal pinhole: what errors are counted from [px]. */
HEXSERVO_API void hexservo_run_goal(const hexservo_run* run, double* features);

/* --- the controller's tick ---------------------------------------------------------------------------------------- */

/** Gains and estimates of the controller of a robot: constant, shared by any number of states. */
typedef struct hexservo_gains hexservo_gains;
/** What a controller keeps from tick to tick. */
typedef struct hexservo_state hexservo_state;

/** Prepares the controller of a scenario. Of `uncertainty` it takes over what the controller itself assumes wrongly:
 * focal length, principal point, mount, depth where the law has a model of the target's points, and the latency of
 * `sampled` mode. A scenario in continuous mode, as a new one is, has a frame and a pose at every tick and no guard
 * against a camera that is gone: it is refused where a key of the controller that acts in `sampled` mode alone,
 * `camera.timeout` for example, has another value than its default.
 * @param period time between two ticks [s], up to 1 s; 0: `simulation.step`
 * @param gains null in case of an error */
HEXSERVO_API hexservo_status hexservo_gains_create(hexservo_scenario* scenario, double period, hexservo_gains** gains);
HEXSERVO_API void hexservo_gains_destroy(hexservo_gains* gains);
HEXSERVO_API double hexservo_gains_period(const hexservo_gains* gains);
HEXSERVO_API size_t hexservo_gains_points(const hexservo_gains* gains);
/** The state before the first tick, with all the memory that ticks need; it refers to no gains. Null: no memory. */
HEXSERVO_API hexservo_state* hexservo_state_create(const hexservo_gains* gains);
HEXSERVO_API void hexservo_state_destroy(hexservo_state* state);

/** Bytes for `hexservo_gains_place`: those of the scenario's law and of how many points it has. */
HEXSERVO_API size_t hexservo_gains_size(const hexservo_scenario* scenario);
/** `hexservo_gains_create` into memory of the caller: any that is at least so large, static for example.
 *
 * All of the gains lies there. They end with the memory, and are not destroyed. The preparation itself takes memory from
 * the heap, and gives it back.
 * @return HEXSERVO_REFUSED also where `size` is too small or `memory` is null */
HEXSERVO_API hexservo_status hexservo_gains_place(hexservo_scenario* scenario, double period, void* memory, size_t size,
                                                  hexservo_gains** gains);
/** Bytes for `hexservo_state_place`; 0: no memory to find out. */
HEXSERVO_API size_t hexservo_state_size(const hexservo_gains* gains);
/** `hexservo_state_create` likewise; takes nothing from the heap. To begin again, place a state there again.
 * @return null where `size` is too small or `memory` is null */
HEXSERVO_API hexservo_state* hexservo_state_place(const hexservo_gains* gains, void* memory, size_t size);

/** Memory for the gains of any scenario, for programs that take none while they run: `hexservo_gains_place(scenario,
 * 0.0, &memory, sizeof memory, &gains)`. It stays where it is: what lies in it is not copied elsewhere. */
typedef struct hexservo_gains_memory {
  double place[1536];
} hexservo_gains_memory;
/** Memory for the state of any law where `camera.latency`, `camera.latency_jitter`, `camera.period` and the size of
 * `uncertainty.latency` are 320 ticks in all; where `camera.latency_known` is false, the first two count as 0.25 s. For
 * more `hexservo_state_size` answers how much. */
typedef struct hexservo_state_memory {
  double place[4608];
} hexservo_state_memory;

/** What the sensors give at a tick; a number that is not known is NaN. */
typedef struct hexservo_input {
  double now;             /**< time of the tick, by a clock that never goes back [s] */
  double exposure;        /**< of the frame, by the same clock; NaN: no frame arrived since the last tick */
  const double* features; /**< 2 per point, pixels as the camera counts them, NaN: not seen; null: no frame */
  const double* depth;    /**< 1 per point, at the exposure, negative in front of the camera [m]; null: none is known */
  double position[3];     /**< of the platform in B [m], where `sensors.pose` is true; as the next two */
  double quaternion[4];   /**< w x y z, of any length but zero */
  double twist[6];        /**< in B [m/s; rad/s] */
  double leg_lengths[6];  /**< where `sensors.pose` is encoders [m], of cranks [rad]; NaN: no reading at this tick */
  double leg_rates[6];    /**< where `sensors.rate` is true [m/s], of cranks [rad/s] */
} hexservo_input;

/** Whether the law acts at a tick, and if not, why; the first that applies. */
typedef enum hexservo_input_status {
  HEXSERVO_VALID = 0,
  HEXSERVO_UNUSABLE = 1,      /**< a number that is not finite or beyond its limit, or a clock that went back */
  HEXSERVO_MISSING_IMAGE = 2, /**< a point has never been seen */
  HEXSERVO_STALE_IMAGE = 3,   /**< a point was not seen for longer than `camera.timeout` */
  HEXSERVO_LOST_FEATURE = 4   /**< `camera.on_lost` is stop, and a point was not seen */
} hexservo_input_status;

/** What a tick gives back. */
typedef struct hexservo_output {
  double wrench[6];             /**< about the platform's origin, in B [N; N m] */
  double leg_forces[6];         /**< positive where they push [N]; of cranks torques [N m] */
  double fuzzy_output[6];       /**< [N; N m] */
  hexservo_input_status status; /**< unless valid the wrench brakes and holds the platform, and nothing is learned */
  int saturated;                /**< a leg force is beyond `robot.force_limit` where `actuators.saturation` is set, or
                                     the legs cannot move as the law would where `actuators.kind` is position */
  double leg_positions[6]; /**< what each leg shall go to where `actuators.kind` is position [m], of cranks [rad]; else
                              NaN */
  double latency[3];       /**< where `camera.latency_known` is false: as found, shortest, longest [s]; otherwise NaN */
} hexservo_output;

/** An input of which nothing is known. */
HEXSERVO_API void hexservo_input_clear(hexservo_input* input);
/** One tick: bounded time, no memory taken, no failure. `state` was made of these gains. */
HEXSERVO_API void hexservo_tick(const hexservo_gains* gains, hexservo_state* state, const hexservo_input* input,
                                hexservo_output* output);

/* --- a plant without its controller ------------------------------------------------------------------------------- */

/** Plant, sensors and actuators of a scenario in sampled mode, which takes commands in place of a law's. */
typedef struct hexservo_plant hexservo_plant;

/** Starts a plant at its first tick; it goes on until it fails (`simulation.duration` does not act).
 * @param plant null in case of an error: those of `hexservo_run_create`, and a scenario in continuous mode */
HEXSERVO_API hexservo_status hexservo_plant_create(hexservo_scenario* scenario, hexservo_plant** plant);
HEXSERVO_API void hexservo_plant_destroy(hexservo_plant* plant);
/** What the sensors give at this tick, as `hexservo_tick` takes it.
 *
 * Position, quaternion and twist are also there with encoders: as the leg lengths give them. Leg lengths and rates are
 * there with encoders alone. Features and depth are those of the newest frame, whose memory is the plant's. */
HEXSERVO_API void hexservo_plant_sense(const hexservo_plant* plant, hexservo_input* input);
/** Commands what the drives take, six numbers, and goes on to the next tick: a wrench about the platform's origin in B
 * [N; N m], and where `actuators.kind` is not force where each leg shall go to [m], cranks [rad].
 *
 * As for custom controllers in Python, the safe output acts in place of a wrench where no law may act, since an image is
 * missing or too old; leg positions always act. Numbers that are not finite end the run as diverged.
 * @return whether there is a tick to command */
HEXSERVO_API int hexservo_plant_command(hexservo_plant* plant, const double* command);
/** `HEXSERVO_RUNNING`, or how it ended. */
HEXSERVO_API hexservo_outcome hexservo_plant_outcome(const hexservo_plant* plant);
/** What was true at the newest tick that was commanded, one before that of the sensors; as `hexservo_run_newest`. Before
 * the first command: where the plant starts, with wrench and forces of zero. */
HEXSERVO_API const double* hexservo_plant_newest(const hexservo_plant* plant, hexservo_quantity quantity);

#ifdef __cplusplus
}
#endif

#endif
