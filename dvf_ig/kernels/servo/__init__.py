"""The servo loop in kernels: clock, shared memory, devices, composition, passivity, supervision, the loop."""
