"""Precompiled headers of Warp, which all threads and later processes share, so that kernels compile faster on a CPU."""

from __future__ import annotations

import hashlib
import os
import platform
from pathlib import Path
from typing import Any

import warp as wp


def share_headers() -> None:
    """Make Warp keep its precompiled headers in the kernel cache, instead of one set for each thread of each process.

    Warp parses its own headers for every set of compiler flags, which takes 2 s, and a module that finds the result
    saves 1.1 s. A cold start has two sets of flags and at least two threads, so it parses them four times or more.
    Clang writes these files under a temporary name and renames them, so that threads and processes cannot read
    incomplete ones. This does not hold on Windows, where Warp's own way remains.

    Warp has no public setting for this. If a later version lacks the replaced method, it is left alone.
    """
    context: Any = wp._src.context  # pyright: ignore[reportPrivateUsage]
    runtime = context.runtime
    if os.name == "posix" and hasattr(runtime, "get_clang_pch_dir") and runtime.llvm is not None:
        runtime.get_clang_pch_dir = _folder


def _folder() -> str | None:
    """Return the folder of the precompiled headers for this processor and these headers; None if it cannot be made."""
    if not wp.config.use_precompiled_headers or wp.config.kernel_cache_dir is None:
        return None
    header = Path(wp.__file__).parent / "native" / "builtin.h"
    # Clang rejects headers that were precompiled for another processor, or before the sources were installed.
    key = f"{header} {header.stat().st_mtime_ns} {_processor()}"
    # `wp.clear_kernel_cache` deletes folders whose names begin with "wp_".
    folder = Path(wp.config.kernel_cache_dir) / f"wp_headers_{hashlib.sha256(key.encode()).hexdigest()[:12]}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return None
    return str(folder)


def _processor() -> str:
    """Return the features of the CPU, as far as the operating system lists them, and otherwise its name."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return f"{platform.machine()} {platform.processor()}"
    return " ".join(sorted({line for line in lines if line.startswith(("model name", "flags", "Features"))}))
