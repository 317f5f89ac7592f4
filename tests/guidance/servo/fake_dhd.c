/* A Force Dimension device that is not there: the vendor's symbols, with a state that a test can look at. */
double fake_position[3] = {0.010, -0.020, 0.030};
double fake_force[3];
int fake_devices = 1, fake_forces_on = 0, fake_broken = 0, fake_forces_sent = 0;

int dhdOpen(void) { return fake_devices > 0 ? 3 : -1; }
int dhdClose(char id) { return id == 3 ? 0 : -1; }
int dhdEnableForce(unsigned char on, char id) {
  fake_forces_on = on;
  return id == 3 ? 0 : -1;
}
int dhdGetPosition(double *x, double *y, double *z, char id) {
  if (fake_broken || id != 3) return -1;
  *x = fake_position[0];
  *y = fake_position[1];
  *z = fake_position[2];
  return 3; /* DHD_TIMEGUARD */
}
int dhdSetForce(double x, double y, double z, char id) {
  if (fake_broken || id != 3) return -1;
  fake_force[0] = x;
  fake_force[1] = y;
  fake_force[2] = z;
  fake_forces_sent++;
  return 2; /* DHD_MOTOR_SATURATED */
}
const char *dhdErrorGetLastStr(void) { return "no device found"; }
