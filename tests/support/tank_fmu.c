/* A heated tank as an FMU, for tests: C dT/dt = heat - loss (T - 20 degC), with FMI's functions for version FMI.

   Its deeds are those of bad FMUs: 1 crashes, 2 waits for ever, 3 reports an error, 4 ends the simulation, 5 computes
   for ever. `threaded` starts a thread; `steps` counts in a static variable, which a new instance does not reset. */
#include <math.h>
#include <pthread.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#ifndef CRASHES
#define CRASHES 0
#endif

enum { T, DER_T, HEAT, EXTRA_U, EXTRA_ACTIVATE, DEED, LOSS, THREADED, STEPS, POWER, MODE, SIZE };

typedef struct { double values[SIZE]; double time; double last; } Tank;

static int steps;

static double power(Tank *tank) {
    return tank->values[HEAT] + (tank->values[EXTRA_ACTIVATE] ? tank->values[EXTRA_U] : 50.0);
}

static double capacity(void) { return 4.186e5; }

static double derivative(Tank *tank) {
    return (power(tank) - tank->values[LOSS] * (tank->values[T] - 20.0)) / capacity();
}

static void *wait_for_ever(void *unused) { for (;;) pause(); return unused; }

static Tank *create(void) {
    if (CRASHES) *(volatile int *)0 = 1;
    Tank *tank = calloc(1, sizeof(Tank));
    tank->values[T] = 20.0;
    tank->values[LOSS] = 2.0;
    return tank;
}

static void initialize(Tank *tank) {
    pthread_t thread;
    if (tank->values[THREADED]) pthread_create(&thread, NULL, wait_for_ever, NULL);
}

static double read_value(Tank *tank, unsigned reference) {
    if (reference == DER_T) return derivative(tank);
    if (reference == POWER) return power(tank);
    if (reference == STEPS) return steps;
    return tank->values[reference];
}

/* Advance exactly; return 0, or FMI's status. */
static int advance(Tank *tank, double time, double size) {
    switch ((int)tank->values[DEED]) {
    case 1: *(volatile int *)0 = 1; break;
    case 2: for (;;) pause();
    case 3: return 3;
    case 4: tank->last = time; return 2;
    case 5: for (volatile int i = 0;; i++) {}
    }
    double steady = 20.0 + power(tank) / tank->values[LOSS];
    tank->values[T] = steady + (tank->values[T] - steady) * exp(-size * tank->values[LOSS] / capacity());
    tank->time = time + size;
    steps++;
    return 0;
}

#if FMI == 2
typedef struct { int needed, terminate, nominals, values, defined; double next; } EventInfo;

const char *fmi2GetTypesPlatform(void) { return "default"; }
const char *fmi2GetVersion(void) { return "2.0"; }
void *fmi2Instantiate(const char *name, int kind, const char *guid, const char *folder, void *callbacks, int visible,
                      int logging) { return create(); }
void fmi2FreeInstance(void *tank) { free(tank); }
int fmi2SetupExperiment(void *tank, int has, double tolerance, double start, int ends, double stop) {
    ((Tank *)tank)->time = start;
    return 0;
}
int fmi2EnterInitializationMode(void *tank) { return 0; }
int fmi2ExitInitializationMode(void *tank) { initialize(tank); return 0; }
int fmi2Terminate(void *tank) { return 0; }
int fmi2GetReal(void *tank, const unsigned *vr, size_t n, double *y) {
    for (size_t i = 0; i < n; i++) y[i] = read_value(tank, vr[i]);
    return 0;
}
int fmi2GetInteger(void *tank, const unsigned *vr, size_t n, int *y) {
    for (size_t i = 0; i < n; i++) y[i] = (int)read_value(tank, vr[i]);
    return 0;
}
int fmi2GetBoolean(void *tank, const unsigned *vr, size_t n, int *y) { return fmi2GetInteger(tank, vr, n, y); }
int fmi2SetReal(void *tank, const unsigned *vr, size_t n, const double *y) {
    for (size_t i = 0; i < n; i++) ((Tank *)tank)->values[vr[i]] = y[i];
    return 0;
}
int fmi2SetInteger(void *tank, const unsigned *vr, size_t n, const int *y) {
    for (size_t i = 0; i < n; i++) ((Tank *)tank)->values[vr[i]] = y[i];
    return 0;
}
int fmi2SetBoolean(void *tank, const unsigned *vr, size_t n, const int *y) { return fmi2SetInteger(tank, vr, n, y); }
int fmi2DoStep(void *tank, double time, double size, int keep) { return advance(tank, time, size); }
int fmi2GetBooleanStatus(void *tank, int kind, int *y) { *y = 1; return 0; }
int fmi2GetRealStatus(void *tank, int kind, double *y) { *y = ((Tank *)tank)->last; return 0; }
int fmi2EnterEventMode(void *tank) { return 0; }
int fmi2EnterContinuousTimeMode(void *tank) { return 0; }
int fmi2NewDiscreteStates(void *tank, EventInfo *info) { memset(info, 0, sizeof(EventInfo)); return 0; }
int fmi2CompletedIntegratorStep(void *tank, int keep, int *event, int *terminate) { *event = *terminate = 0; return 0; }
int fmi2SetTime(void *tank, double time) { ((Tank *)tank)->time = time; return 0; }
int fmi2SetContinuousStates(void *tank, const double *x, size_t n) { ((Tank *)tank)->values[T] = x[0]; return 0; }
int fmi2GetContinuousStates(void *tank, double *x, size_t n) { x[0] = ((Tank *)tank)->values[T]; return 0; }
int fmi2GetDerivatives(void *tank, double *dx, size_t n) { dx[0] = derivative(tank); return 0; }
int fmi2GetEventIndicators(void *tank, double *z, size_t n) { return 0; }
int fmi2GetNominalsOfContinuousStates(void *tank, double *x, size_t n) { x[0] = 1.0; return 0; }
#else
const char *fmi3GetVersion(void) { return "3.0"; }
void *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *folder, bool visible, bool logging,
                                  bool events, bool early, const unsigned *vr, size_t n, void *environment, void *log,
                                  void *update) { return create(); }
void fmi3FreeInstance(void *tank) { free(tank); }
int fmi3EnterInitializationMode(void *tank, bool has, double tolerance, double start, bool ends, double stop) {
    ((Tank *)tank)->time = start;
    return 0;
}
int fmi3ExitInitializationMode(void *tank) { initialize(tank); return 0; }
int fmi3Terminate(void *tank) { return 0; }
int fmi3GetFloat64(void *tank, const unsigned *vr, size_t n, double *y, size_t m) {
    for (size_t i = 0; i < n; i++) y[i] = read_value(tank, vr[i]);
    return 0;
}
int fmi3GetInt32(void *tank, const unsigned *vr, size_t n, int32_t *y, size_t m) {
    for (size_t i = 0; i < n; i++) y[i] = (int)read_value(tank, vr[i]);
    return 0;
}
int fmi3SetFloat64(void *tank, const unsigned *vr, size_t n, const double *y, size_t m) {
    for (size_t i = 0; i < n; i++) ((Tank *)tank)->values[vr[i]] = y[i];
    return 0;
}
int fmi3SetInt32(void *tank, const unsigned *vr, size_t n, const int32_t *y, size_t m) {
    for (size_t i = 0; i < n; i++) ((Tank *)tank)->values[vr[i]] = y[i];
    return 0;
}
int fmi3SetInt64(void *tank, const unsigned *vr, size_t n, const int64_t *y, size_t m) {
    for (size_t i = 0; i < n; i++) ((Tank *)tank)->values[vr[i]] = y[i];
    return 0;
}
int fmi3GetInt64(void *tank, const unsigned *vr, size_t n, int64_t *y, size_t m) {
    for (size_t i = 0; i < n; i++) y[i] = (int64_t)read_value(tank, vr[i]);
    return 0;
}
int fmi3SetBoolean(void *tank, const unsigned *vr, size_t n, const bool *y, size_t m) {
    for (size_t i = 0; i < n; i++) ((Tank *)tank)->values[vr[i]] = y[i];
    return 0;
}
int fmi3DoStep(void *tank, double time, double size, bool keep, bool *event, bool *terminate, bool *early,
               double *last) {
    int status = advance(tank, time, size);
    *event = *early = false;
    *terminate = status == 2;
    *last = status ? time : time + size;
    return status == 2 ? 0 : status;
}
#endif
