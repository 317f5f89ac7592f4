"""Vendors' devices against shared libraries with the vendors' symbols, compiled here."""

import ctypes
import gc
import shutil
import time
from contextlib import closing

import numpy as np
import pytest
from fake_library import compiled
from waiting import until

from dvf_ig.core import Rigid
from dvf_ig.guidance import Fixtures, FixtureSet, SupervisorState
from dvf_ig.guidance.devices import ForceDimensionDevice, OpenHapticsDevice
from dvf_ig.guidance.devices.vendor_library import VendorLibraryError
from dvf_ig.guidance.servo import Servo, ServoInputs
from dvf_ig.kernels.servo.openhaptics import exchange

from .conftest import PATIENT_S


@pytest.fixture
def dhd(tmp_path):
    return compiled("fake_dhd", tmp_path)


@pytest.fixture
def hd(tmp_path):
    return compiled("fake_hd", tmp_path)


@pytest.fixture
def touch(hd):
    """Closed in the end even where the test fails: until then its scheduler writes to the device's memory."""
    with closing(OpenHapticsDevice(path=hd, lost_after_s=0.5)) as device:
        yield device


def number(library, name, kind=ctypes.c_int):
    return kind.in_dll(ctypes.CDLL(str(library)), name)


def vector(library, name):
    return (ctypes.c_double * 3).in_dll(ctypes.CDLL(str(library)), name)


@pytest.mark.parametrize(
    ("device", "variable", "what"),
    [
        (ForceDimensionDevice, "FORCEDIM_SDK", "install the SDK"),
        (OpenHapticsDevice, "HOME", "install OpenHaptics"),
    ],
)
def test_a_missing_library_is_named_with_what_to_do(device, variable, what, monkeypatch, tmp_path):
    monkeypatch.setenv(variable, str(tmp_path))
    with pytest.raises(VendorLibraryError, match=what):
        device()
    with pytest.raises(VendorLibraryError, match="nowhere"):
        device(path=tmp_path / "nowhere.so")


@pytest.mark.parametrize("device", [ForceDimensionDevice, OpenHapticsDevice])
def test_another_library_is_refused(device, dhd, hd):
    wrong = hd if device is ForceDimensionDevice else dhd
    with pytest.raises(VendorLibraryError, match="lacks"):
        device(path=wrong)


def test_the_sdk_s_folder_is_searched(dhd, monkeypatch, tmp_path):
    import platform

    place = tmp_path / "sdk" / "lib" / "release" / f"lin-{platform.machine()}-gcc"
    place.mkdir(parents=True)
    shutil.copy(dhd, place / "libdhd.so")
    monkeypatch.setenv("FORCEDIM_SDK", str(tmp_path / "sdk"))
    ForceDimensionDevice().close()


@pytest.mark.parametrize(("device", "fake"), [(ForceDimensionDevice, "dhd"), (OpenHapticsDevice, "hd")])
def test_no_device_is_an_error_with_the_vendor_s_reason(device, fake, request):
    library = request.getfixturevalue(fake)
    number(library, "fake_devices").value = 0
    with pytest.raises(VendorLibraryError, match=r"no device found|0x0305"):
        device(path=library)


def run_servo(ball, steady_ball, device, at_device_mm, look):
    """The servo on a device whose position is 15 mm from the ball's centre; `look` is called meanwhile."""
    tracker_from_device = Rigid.from_rotation_vector([0.0, 0.0, 0.5], [0.0, 0.0, 0.0], "tracker", "device")
    moved = tracker_from_device.apply_array(np.array([at_device_mm]))[0]
    place = Rigid("tracker", "device", tracker_from_device.rotation, np.array([15.0, 0.0, 0.0]) - moved)
    with Servo(Fixtures(ball, FixtureSet()), device, watchdog=False, late_s=PATIENT_S) as servo:
        begin = time.monotonic()

        def speak():
            servo.publish(ServoInputs(steady_ball, time.monotonic() - begin, place, valid_for_s=5.0))
            return servo.read()

        return look(speak, place)


def felt(speak, place, force):
    """Until the device has the force of the servo's last tick, in its own frame."""

    def same():
        record = speak()
        if len(record) == 0 or record.state[-1] != SupervisorState.OK:
            return False
        expected = record.sent_n[-1] @ place.rotation
        return np.linalg.norm(expected) > 0.05 and np.abs(np.array(force) - expected).max() < 0.02

    until(same)


def test_a_force_dimension_device_is_driven_in_metres(dhd, ball, steady_ball):
    device = ForceDimensionDevice(path=dhd)
    assert number(dhd, "fake_forces_on").value == 1
    run_servo(
        ball,
        steady_ball,
        device,
        [10.0, -20.0, 30.0],
        lambda speak, place: felt(speak, place, vector(dhd, "fake_force")),
    )
    assert number(dhd, "fake_forces_sent").value > 10
    np.testing.assert_array_equal(list(vector(dhd, "fake_force")), 0.0)
    assert device.ends_force_after_s == 0.015
    assert number(dhd, "fake_watchdog").value == 120
    assert device.rate_hz == 4000.0
    assert device.limits is None
    device.close()
    device.close()
    assert number(dhd, "fake_forces_on").value == 0


@pytest.mark.parametrize(
    ("kind", "fake", "button"),
    [(ForceDimensionDevice, "dhd", "fake_button"), (OpenHapticsDevice, "hd", "fake_buttons")],
)
def test_a_button_is_read_while_a_servo_runs(kind, fake, button, request, ball, steady_ball):
    library = request.getfixturevalue(fake)

    def look(speak, place):
        assert not device.pressed
        number(library, button).value = 1
        until(lambda: speak() is not None and device.pressed)
        number(library, button).value = 0
        until(lambda: speak() is not None and not device.pressed)

    with closing(kind(path=library)) as device:
        run_servo(ball, steady_ball, device, [10.0, -20.0, 30.0], look)


def test_openhaptics_states_the_limits_of_its_driver(touch):
    assert touch.limits is not None
    assert touch.limits.stiffness_n_per_m == 500.0
    assert touch.limits.continuous_force_n == 0.88
    assert touch.limits.name == touch.name


def test_a_force_dimension_device_that_breaks_latches(dhd, ball, steady_ball):
    device = ForceDimensionDevice(path=dhd)

    def look(speak, place):
        felt(speak, place, vector(dhd, "fake_force"))
        number(dhd, "fake_broken").value = 1
        until(lambda: SupervisorState.LATCHED in speak().state)

    run_servo(ball, steady_ball, device, [10.0, -20.0, 30.0], look)
    device.close()


def test_an_openhaptics_device_is_driven_inside_its_frames(hd, touch, ball, steady_ball):
    run_servo(
        ball,
        steady_ball,
        touch,
        [10.0, -20.0, 30.0],
        lambda speak, place: felt(speak, place, vector(hd, "fake_force")),
    )
    until(lambda: not any(vector(hd, "fake_force")))
    assert number(hd, "fake_misuse").value == 0
    assert number(hd, "fake_forces_on").value == 1
    touch.close()
    touch.close()
    assert number(hd, "fake_forces_on").value == 0


def test_an_openhaptics_device_that_is_dropped_stops_the_drivers_thread(hd):
    device = OpenHapticsDevice(path=hd)
    assert number(hd, "fake_forces_on").value == 1
    del device
    gc.collect()
    assert number(hd, "fake_forces_on").value == 0


def test_a_servo_that_falls_silent_leaves_no_force_on_an_openhaptics_device(hd, touch):
    write = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p, ctypes.c_int64, ctypes.POINTER(ctypes.c_double))(
        int(touch.functions[1])
    )
    given, force = (ctypes.c_double * 3)(0.1, 0.2, 0.3), vector(hd, "fake_force")
    until(lambda: write(touch.context.ctypes.data, 0, given) or list(force) == [0.1, 0.2, 0.3])
    until(lambda: not any(force))
    touch.close()


def test_a_scheduler_that_wakes_before_the_servo_gives_no_old_force(hd, touch):
    """As after a stopped process: no callback and no write for a while, then a callback."""
    write = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p, ctypes.c_int64, ctypes.POINTER(ctypes.c_double))(
        int(touch.functions[1])
    )
    number(hd, "fake_stalled").value = 1
    context, given, force = (
        touch.context.ctypes.data,
        (ctypes.c_double * 3)(0.1, 0.2, 0.3),
        vector(hd, "fake_force"),
    )
    until(lambda: write(context, 0, given) or (exchange.ctypes(context) and list(force) == list(given)))
    time.sleep(0.012)
    exchange.ctypes(context)
    assert not any(force)
    touch.close()


@pytest.mark.parametrize(("name", "value"), [("fake_stalled", 1), ("fake_error", 0x0303)])
def test_a_scheduler_that_stops_or_fails_is_a_lost_device(hd, touch, ball, steady_ball, name, value):
    def look(speak, place):
        felt(speak, place, vector(hd, "fake_force"))
        number(hd, name).value = value
        until(lambda: SupervisorState.LATCHED in speak().state)

    run_servo(ball, steady_ball, touch, [10.0, -20.0, 30.0], look)
    assert touch.error_code == (value if name == "fake_error" else 0)
    touch.close()
