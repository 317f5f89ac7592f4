/* A Force Dimension device that is not there: the vendor's symbols, with a state that a test can look at.

   With the variable FAKE_DHD it is the state of a file that another process shares, so that a test sees the forces
   of a program that was killed. Numbers in it: position (m), force, broken (2: commands
   still work), seconds that the next command hangs,
   button, steps of the watchdog, numbers of commands and of enablings; from 16 on the time and size of each. */
#include <fcntl.h>
#include <math.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <time.h>
#include <unistd.h>

enum { POSITION = 0, FORCE = 3, BROKEN = 6, HANG_S = 7, BUTTON = 8, WATCHDOG = 9, COUNT = 10, ENABLES = 11, LOG = 16, KEPT = 200000 };

double fake_position[3] = {0.010, -0.020, 0.030};
double fake_force[3];
int fake_devices = 1, fake_forces_on = 0, fake_broken = 0, fake_forces_sent = 0, fake_button = 0, fake_watchdog = 0;
static volatile double *shared = 0;

static double now_s(void) {
  struct timespec t;
  clock_gettime(CLOCK_MONOTONIC, &t);
  return t.tv_sec + 1e-9 * t.tv_nsec;
}
int dhdOpen(void) {
  const char *path = getenv("FAKE_DHD");
  if (path && !shared) {
    int file = open(path, O_RDWR);
    if (file < 0) return -1;
    void *map = mmap(0, 8 * (LOG + 2 * KEPT), PROT_READ | PROT_WRITE, MAP_SHARED, file, 0);
    close(file);
    if (map == MAP_FAILED) return -1;
    shared = map;
  }
  return fake_devices > 0 ? 3 : -1;
}
int dhdClose(char id) { return id == 3 ? 0 : -1; }
int dhdEnableForce(unsigned char on, char id) {
  fake_forces_on = on;
  if (shared && on) shared[ENABLES] += 1;
  return id == 3 ? 0 : -1;
}
int dhdSetWatchdog(unsigned char steps, char id) {
  fake_watchdog = steps;
  if (shared) shared[WATCHDOG] = steps;
  return id == 3 ? 0 : -1;
}
int dhdGetButton(int index, char id) {
  if (id != 3 || index != 0) return -1;
  return shared ? (int)shared[BUTTON] : fake_button;
}
int dhdGetPosition(double *x, double *y, double *z, char id) {
  if (fake_broken || id != 3 || (shared && shared[BROKEN] != 0)) return -1;
  *x = shared ? shared[POSITION] : fake_position[0];
  *y = shared ? shared[POSITION + 1] : fake_position[1];
  *z = shared ? shared[POSITION + 2] : fake_position[2];
  return 3; /* DHD_TIMEGUARD */
}
int dhdSetForce(double x, double y, double z, char id) {
  if (fake_broken || id != 3 || (shared && shared[BROKEN] == 1)) return -1;
  if (shared && shared[HANG_S] > 0) {
    double hang_s = shared[HANG_S];
    shared[HANG_S] = 0; /* only one call hangs */
    usleep((useconds_t)(1e6 * hang_s));
  }
  fake_force[0] = x;
  fake_force[1] = y;
  fake_force[2] = z;
  fake_forces_sent++;
  if (shared) {
    long n = (long)shared[COUNT] % KEPT;
    for (int k = 0; k < 3; k++) shared[FORCE + k] = fake_force[k];
    shared[LOG + 2 * n] = now_s();
    shared[LOG + 2 * n + 1] = sqrt(x * x + y * y + z * z);
    shared[COUNT] += 1;
  }
  return 2; /* DHD_MOTOR_SATURATED */
}
const char *dhdErrorGetLastStr(void) { return "no device found"; }
