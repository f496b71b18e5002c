"""Runs while other processes want the cores, always, never or now and then."""

from warpcrete.core.device.cores import CoreContention


def results_under_contention(monkeypatch, compute):
    """Return the different results of `compute()`; each time, one thread does the work of all at other times."""
    results, used = set(), set()
    for contended in (lambda n: False, lambda n: True, lambda n: n % 3 == 0):
        numbers = iter(range(10**9))

        def use_one_thread(self, contended=contended, numbers=numbers):
            used.add(answer := contended(next(numbers)))
            return answer

        monkeypatch.setattr(CoreContention, "use_one_thread", use_one_thread)
        results.add(compute())
    assert used == {False, True}
    return results
