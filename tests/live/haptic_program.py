"""A program that drives a fake Force Dimension device at a steady ball until it is ended by a signal."""

import sys
import threading
import time

from haptic_toy import NEVER_NS, steady_state, toy_tool
from waiting import until

from dvf_ig.cli.serve.command import _end_requests
from dvf_ig.guidance.devices import open_device
from dvf_ig.kernels.servo import loop as kernel


def say(sentence: str) -> None:
    sys.stdout.write(sentence + "\n")
    sys.stdout.flush()


def main() -> None:
    tool = toy_tool(open_device("force-dimension"), say)
    tool._servo._loop.numbers[[kernel.LATE_NS, kernel.SILENT_NS]] = NEVER_NS
    with tool, _end_requests(tool) as ended:
        stop = threading.Event()

        def publish() -> None:
            while not stop.wait(0.01):
                tool.publish(steady_state(time.monotonic()))
                tool.poses(time.monotonic())

        thread = threading.Thread(target=publish, daemon=True)
        thread.start()
        until(lambda: tool.sent.force_n.any())
        say("ready")
        until(ended)
        say(tool.ended)
        stop.set()
        thread.join()


if __name__ == "__main__":
    main()
