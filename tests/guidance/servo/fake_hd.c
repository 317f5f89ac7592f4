/* An OpenHaptics device that is not there: its scheduler is a thread that calls back once a millisecond. */
#include <pthread.h>
#include <time.h>

typedef struct {
  unsigned code;
  int internal;
  unsigned handle;
} ErrorInfo;
typedef unsigned (*Callback)(void *);

double fake_position[3] = {10.0, -20.0, 30.0};
double fake_force[3];
int fake_devices = 1, fake_forces_on = 0, fake_in_frame = 0, fake_misuse = 0, fake_stalled = 0, fake_running = 0, fake_buttons = 0;
unsigned fake_error = 0;
static Callback callback;
static void *data;
static pthread_t thread;

static void *run(void *unused) {
  struct timespec millisecond = {0, 1000000};
  while (fake_running) {
    if (callback && !fake_stalled) callback(data);
    nanosleep(&millisecond, 0);
  }
  return unused;
}

unsigned hdInitDevice(const char *name) {
  (void)name;
  return fake_devices > 0 ? 5 : 0xFFFFFFFFu;
}
void hdDisableDevice(unsigned handle) { fake_devices += handle == 5; }
void hdEnable(unsigned what) { fake_forces_on |= what == 0x4000; }
void hdDisable(unsigned what) { fake_forces_on &= what != 0x4000; }
void hdStartScheduler(void) {
  fake_running = 1;
  pthread_create(&thread, 0, run, 0);
}
void hdStopScheduler(void) {
  fake_running = 0, fake_buttons = 0;
  pthread_join(thread, 0);
}
unsigned long hdScheduleAsynchronous(Callback function, void *user, unsigned short priority) {
  (void)priority;
  callback = function;
  data = user;
  return 7;
}
void hdUnschedule(unsigned long handle) {
  if (handle == 7) callback = 0;
}
void hdBeginFrame(unsigned handle) { fake_in_frame = handle == 5; }
void hdEndFrame(unsigned handle) {
  (void)handle;
  fake_in_frame = 0;
}
void hdGetDoublev(unsigned name, double *out) {
  if (name == 0x2602 || name == 0x2604) {
    *out = name == 0x2602 ? 0.5 : 0.88;
    return;
  }
  fake_misuse |= !fake_in_frame || name != 0x2050;
  for (int k = 0; k < 3; k++) out[k] = fake_position[k];
}
void hdSetDoublev(unsigned name, const double *in) {
  fake_misuse |= !fake_in_frame || name != 0x2700;
  for (int k = 0; k < 3; k++) fake_force[k] = in[k];
}
ErrorInfo hdGetError(void) {
  ErrorInfo info = {fake_devices > 0 ? fake_error : 0x0305u, 42, 5};
  return info;
}
void hdGetIntegerv(unsigned name, int *out) {
  fake_misuse |= !fake_in_frame || name != 0x2000;
  *out = fake_buttons;
}
