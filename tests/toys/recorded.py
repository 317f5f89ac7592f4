"""What a synthetic scenario always records, with its type known."""

from dvf_ig.core import LatencyRecording, NWireRecording, PoseStream, Scenario


def tool_of(scenario: Scenario) -> PoseStream:
    assert scenario.tool is not None
    return scenario.tool


def pivot_of(scenario: Scenario) -> PoseStream:
    assert isinstance(scenario.tip, PoseStream)
    return scenario.tip


def nwire_of(scenario: Scenario) -> NWireRecording:
    assert isinstance(scenario.probe, NWireRecording)
    return scenario.probe


def latency_of(scenario: Scenario) -> LatencyRecording:
    assert isinstance(scenario.latency, LatencyRecording)
    return scenario.latency
