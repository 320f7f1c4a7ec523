"""Chains futures: work that begins with the result of another."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from typing import TypeVar

T = TypeVar("T")
R = TypeVar("R")


def then(first: Future[T], act: Callable[[T], R]) -> Future[R]:
    """Future of ``act(result of first)``, called on the thread that completes ``first``.

    Fails if either fails.
    """
    result: Future[R] = Future()

    def proceed(done: Future[T]) -> None:
        try:
            value = act(done.result())
        except Exception as error:
            result.set_exception(error)
        else:
            result.set_result(value)

    first.add_done_callback(proceed)
    return result


def then_start(first: Future[T], start: Callable[[T], Future[R]]) -> Future[R]:
    """Future of the work that ``start(result of first)`` begins; fails if any of them fails."""
    result: Future[R] = Future()

    def copy(done: Future[R]) -> None:
        error = done.exception()
        if error is None:
            result.set_result(done.result())
        else:
            result.set_exception(error)

    def proceed(done: Future[Future[R]]) -> None:
        error = done.exception()
        if error is None:
            done.result().add_done_callback(copy)
        else:
            result.set_exception(error)

    then(first, start).add_done_callback(proceed)
    return result
