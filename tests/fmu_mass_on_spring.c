/* A mass on a spring as a functional mock-up unit, FMI 2.0 (-DFMI=2) or 3.0 (-DFMI=3), written for these tests.

   m dv/dt = F - c v - k q - k3 q^3,  dq/dt = v;  at q = wall: v -> -v;  at t = kick_time: v -> v + 1.

   "fault": 1 crashes, 2 hangs, 3 NaN rates for q > 0, 4 prints, 5 ends the simulation, 6 reports an error, 7 rates that
   depend on time, 8 wrong directional derivatives, 9 an event that never settles.  */
#include <math.h>
#include <signal.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { Q, V, DQ, DV, F, A, M, C, K, K3, WALL, KICK, FAULT, N };
typedef struct {
  double x[N], time;
  bool kicked;
  void (*log)();
  void *environment;
} Unit;

static Unit *fresh(void) {
  Unit *u = calloc(1, sizeof(Unit));
  double start[N] = {[Q] = 0.5, [M] = 2, [C] = 0.4, [K] = 8, [WALL] = 1e9, [KICK] = 1e9};
  memcpy(u->x, start, sizeof start);
  return u;
}

static double rate_of_v(const Unit *u) {
  const double *x = u->x;
  double kink = x[FAULT] == 7 ? u->time : 0;
  return (x[F] - x[C] * x[V] - x[K] * x[Q] - x[K3] * x[Q] * x[Q] * x[Q] + kink) / x[M];
}

static int rates(Unit *u) {
  int fault = (int)u->x[FAULT];
  if (fault == 1) raise(SIGSEGV);
  if (fault == 2) for (volatile int k = 0;; k++) { }
  if (fault == 4) { printf("noise\n"); fflush(stdout); fprintf(stderr, "noise\n"); }
  u->x[DQ] = u->x[V];
  u->x[DV] = fault == 3 && u->x[Q] > 0 ? NAN : rate_of_v(u);
  u->x[A] = rate_of_v(u);
  return 0;
}

/* Values of the discrete variables: whether the states have changed; the next event. */
static bool discrete(Unit *u, double *next) {
  bool changed = false;
  if (u->x[Q] >= u->x[WALL] && u->x[V] > 0) { u->x[V] = -u->x[V]; changed = true; }
  if (!u->kicked && u->time >= u->x[KICK]) { u->x[V] += 1; u->kicked = changed = true; }
  *next = u->x[KICK];
  return changed;
}

/* d(unknown)/d(known), for q, v, F alone. */
static double slope(const Unit *u, unsigned unknown, unsigned known) {
  const double *x = u->x;
  if (unknown == DQ) return known == V;
  if (unknown != DV && unknown != A) return 0;
  double wrong = x[FAULT] == 8 ? 1.5 : 1;
  if (known == Q) return -wrong * (x[K] + 3 * x[K3] * x[Q] * x[Q]) / x[M];
  return (known == V ? -x[C] : known == F ? 1 : 0) / x[M];
}

static void classical_step(Unit *u, double h) {
  double q = u->x[Q], v = u->x[V], a[4], b[4];
  for (int k = 0; k < 4; k++) {
    double s = k == 0 ? 0 : k == 3 ? h : h / 2;
    u->x[Q] = q + (k ? s * a[k - 1] : 0);
    u->x[V] = v + (k ? s * b[k - 1] : 0);
    rates(u);
    a[k] = u->x[DQ];
    b[k] = u->x[DV];
  }
  u->x[Q] = q + h / 6 * (a[0] + 2 * a[1] + 2 * a[2] + a[3]);
  u->x[V] = v + h / 6 * (b[0] + 2 * b[1] + 2 * b[2] + b[3]);
}

static int get(Unit *u, const unsigned *r, size_t n, double *value) {
  if (rates(u)) return 3;
  for (size_t k = 0; k < n; k++) value[k] = u->x[r[k]];
  return 0;
}

static int set(Unit *u, const unsigned *r, size_t n, const double *value) {
  for (size_t k = 0; k < n; k++) u->x[r[k]] = value[k];
  return 0;
}

static int get_states(Unit *u, double *x) { x[0] = u->x[Q]; x[1] = u->x[V]; return 0; }
static int set_states(Unit *u, const double *x) { u->x[Q] = x[0]; u->x[V] = x[1]; return 0; }
static int set_time(Unit *u, double t) { u->time = t; return 0; }
static int get_rates(Unit *u, double *f) { int bad = rates(u); f[0] = u->x[DQ]; f[1] = u->x[DV]; return bad; }
static int indicators(Unit *u, double *z) { z[0] = u->x[WALL] - u->x[Q]; return 0; }

static int do_step(Unit *u, double h) {
  int n = 1 + (int)(h / 1e-3);
  for (int k = 0; k < n; k++) classical_step(u, h / n);
  return 0;
}
static int derivative(Unit *u, const unsigned *unknown, size_t n, const unsigned *known, size_t m, const double *seed,
                      double *found) {
  for (size_t k = 0; k < n; k++) {
    found[k] = 0;
    for (size_t j = 0; j < m; j++) found[k] += slope(u, unknown[k], known[j]) * seed[j];
  }
  return 0;
}

#if FMI == 2
typedef struct { void (*logger)(); void *(*allocate)(); void (*release)(); void (*finished)(); void *environment; } Callbacks;
typedef struct { int again, ended, nominals, changed, announced; double next; } EventInfo;

void *fmi2Instantiate(const char *name, int type, const char *token, const char *resources, const Callbacks *calls,
                      int visible, int logging) {
  if (strcmp(token, "mass-on-spring")) return NULL;
  Unit *u = fresh();
  u->log = calls->logger;
  u->environment = calls->environment;
  return u;
}
const char *fmi2GetVersion(void) { return "2.0"; }
void fmi2FreeInstance(Unit *u) { free(u); }
int fmi2SetupExperiment(Unit *u, int d, double tolerance, double start, int e, double stop) { u->time = start; return 0; }
int fmi2EnterInitializationMode(Unit *u) { return 0; }
int fmi2ExitInitializationMode(Unit *u) {
  if (u->x[FAULT] != 6) return 0;
  u->log(u->environment, "unit", 3, "error", "the spring is %s", "broken");
  return 3;
}
int fmi2GetReal(Unit *u, const unsigned *r, size_t n, double *value) { return get(u, r, n, value); }
int fmi2SetReal(Unit *u, const unsigned *r, size_t n, const double *value) { return set(u, r, n, value); }
int fmi2SetTime(Unit *u, double t) { return set_time(u, t); }
int fmi2GetContinuousStates(Unit *u, double *x, size_t n) { return get_states(u, x); }
int fmi2SetContinuousStates(Unit *u, const double *x, size_t n) { return set_states(u, x); }
int fmi2GetDerivatives(Unit *u, double *f, size_t n) { return get_rates(u, f); }
int fmi2GetEventIndicators(Unit *u, double *z, size_t n) { return indicators(u, z); }
int fmi2GetNominalsOfContinuousStates(Unit *u, double *x, size_t n) { x[0] = x[1] = 1; return 0; }
int fmi2Terminate(Unit *u) { return 0; }
int fmi2EnterEventMode(Unit *u) { return 0; }
int fmi2EnterContinuousTimeMode(Unit *u) { return 0; }
int fmi2NewDiscreteStates(Unit *u, EventInfo *e) {
  memset(e, 0, sizeof *e);
  e->changed = discrete(u, &e->next);
  e->announced = !u->kicked && u->x[KICK] < 1e9;
  e->again = u->x[FAULT] == 9;
  return 0;
}
int fmi2CompletedIntegratorStep(Unit *u, int prior, int *event, int *ended) {
  *event = 0;
  *ended = u->x[FAULT] == 5 && u->time > 0.5;
  return 0;
}
int fmi2GetDirectionalDerivative(Unit *u, const unsigned *unknown, size_t n, const unsigned *known, size_t m,
                                 const double *seed, double *found) {
  return derivative(u, unknown, n, known, m, seed, found);
}
int fmi2DoStep(Unit *u, double t, double h, int prior) { return do_step(u, h); }
#else
void *fmi3InstantiateModelExchange(const char *name, const char *token, const char *resources, bool visible, bool logging,
                                   void *environment, void (*log)()) {
  if (strcmp(token, "mass-on-spring")) return NULL;
  Unit *u = fresh();
  u->log = log;
  u->environment = environment;
  return u;
}
void *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *resources, bool visible, bool logging,
                                  bool events, bool early, const unsigned *r, size_t n, void *environment, void (*log)(),
                                  void (*update)()) {
  return fmi3InstantiateModelExchange(name, token, resources, visible, logging, environment, log);
}
const char *fmi3GetVersion(void) { return "3.0"; }
void fmi3FreeInstance(Unit *u) { free(u); }
int fmi3EnterInitializationMode(Unit *u, bool d, double tolerance, double start, bool e, double stop) {
  u->time = start;
  return 0;
}
int fmi3ExitInitializationMode(Unit *u) {
  if (u->x[FAULT] != 6) return 0;
  u->log(u->environment, 3, "error", "the spring is broken");
  return 3;
}
int fmi3GetFloat64(Unit *u, const unsigned *r, size_t n, double *value, size_t m) { return get(u, r, n, value); }
int fmi3SetFloat64(Unit *u, const unsigned *r, size_t n, const double *value, size_t m) { return set(u, r, n, value); }
int fmi3SetTime(Unit *u, double t) { return set_time(u, t); }
int fmi3GetContinuousStates(Unit *u, double *x, size_t n) { return get_states(u, x); }
int fmi3SetContinuousStates(Unit *u, const double *x, size_t n) { return set_states(u, x); }
int fmi3GetContinuousStateDerivatives(Unit *u, double *f, size_t n) { return get_rates(u, f); }
int fmi3GetEventIndicators(Unit *u, double *z, size_t n) { return indicators(u, z); }
int fmi3EnterEventMode(Unit *u) { return 0; }
int fmi3EnterContinuousTimeMode(Unit *u) { return 0; }
int fmi3UpdateDiscreteStates(Unit *u, bool *again, bool *ended, bool *nominals, bool *changed, bool *announced,
                             double *next) {
  *changed = discrete(u, next);
  *announced = !u->kicked && u->x[KICK] < 1e9;
  *again = u->x[FAULT] == 9;
  *ended = *nominals = false;
  return 0;
}
int fmi3CompletedIntegratorStep(Unit *u, bool prior, bool *event, bool *ended) {
  *event = false;
  *ended = u->x[FAULT] == 5 && u->time > 0.5;
  return 0;
}
int fmi3GetDirectionalDerivative(Unit *u, const unsigned *unknown, size_t n, const unsigned *known, size_t m,
                                 const double *seed, size_t s, double *found, size_t f) {
  return derivative(u, unknown, n, known, m, seed, found);
}
int fmi3DoStep(Unit *u, double t, double h, bool prior, bool *event, bool *ended, bool *early, double *last) {
  *event = *ended = *early = false;
  *last = t + h;
  return do_step(u, h);
}
#endif
