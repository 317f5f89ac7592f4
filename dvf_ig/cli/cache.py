"""`dvf-ig cache`: models that were built and kept; how much they take, and remove them."""

from typing import Annotated

from typer import Option

from .shell import JsonFlag, command, emit


def cache(
    clear: Annotated[bool, Option("--clear", help="Remove all models from the cache.")] = False,
    as_json: JsonFlag = False,
) -> None:
    """Show the cache of built models and its size, or clear it.

    `replay`, `register` and `serve` keep each model that they build from labels or surfaces, so that it is
    built once. DVF_IG_CACHE names another folder; DVF_IG_CACHE=off keeps none.
    """
    with command(lists_inputs=False):
        from dvf_ig.intake.model_cache import MAX_BYTES, cache_entries, cache_folder, clear_cache

        folder, sizes = cache_folder(), cache_entries()
        removed = clear_cache() if clear else 0
        result = {
            "folder": None if folder is None else str(folder),
            "models": len(sizes) - removed,
            "megabytes": round(sum(cache_entries().values()) / 1e6, 3),
            "limit_megabytes": MAX_BYTES / 1e6,
            "removed": removed,
        }
        rows = [
            ("folder", "none: the cache is off" if folder is None else str(folder)),
            (
                "models",
                f"{result['models']}, {result['megabytes']:.1f} MB of {MAX_BYTES / 1e6:.0f} MB at most",
            ),
        ]
        if clear:
            rows.append(("removed", f"{removed} models, {sum(sizes.values()) / 1e6:.1f} MB"))
        emit(result, rows, as_json=as_json)
