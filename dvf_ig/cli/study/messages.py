"""`dvf-ig study messages`: wrong OpenIGTLink messages by the ten thousand."""

from typing import Annotated

import typer

from dvf_ig.cli.shell import JsonFlag, SeedOption, command, emit


def messages(
    count: Annotated[int, typer.Option("--count", min=1, help="Wrong messages.")] = 50_000,
    as_json: JsonFlag = False,
    seed: SeedOption = 1,
) -> None:
    """Damage OpenIGTLink messages and feed them to the decoder, and a part of them to a connection.

    Each must end as a message or be refused with a reason, within 50 ms of computing, in bounded memory; any
    other exception is counted as foreign. Exits 7 where there is one, or a hang.
    """
    with command(lists_inputs=False):
        from dataclasses import asdict

        from dvf_ig.core import QualityGateError
        from dvf_ig.live.priority import answering_soon
        from dvf_ig.study.live.hostile_peer import hostile_peer
        from dvf_ig.study.live.wrong_messages import feed_wrong_messages

        with answering_soon():
            found = feed_wrong_messages(count, seed)
            held = feed_wrong_messages(max(1, count // 20), seed + 1, memory=True)
            peer = hostile_peer(max(1, count // 20), seed + 2)
        result = {
            **asdict(found),
            "refused": dict(found.refused),
            "foreign": dict(found.foreign),
            "peak_bytes": held.peak_bytes,
            "over_loopback": asdict(peer),
        }
        rows: list[tuple[str, ...]] = [
            ("wrong messages", str(found.messages)),
            ("messages after all", str(found.accepted)),
            *(
                (f"refused: {name.lower().replace('_', ' ')}", str(n))
                for name, n in found.refused.most_common()
            ),
            ("foreign exceptions", str(sum(found.foreign.values()))),
            ("slowest", f"{1e3 * found.slowest_s:.2f} ms of computing; {found.hangs} above 50 ms"),
            ("memory held", f"{held.peak_bytes / 1e6:.2f} MB at the most"),
            ("over loopback", f"{peer.sent} sent, {peer.arrived} arrived, {peer.refused} refused"),
            ("longest wait of the session's thread", f"{1e3 * peer.longest_wait_s:.1f} ms"),
        ]
        emit(result, rows, as_json=as_json)
        if not found.clean:
            raise QualityGateError(f"{found.hangs} hangs, foreign exceptions {dict(found.foreign)}")
