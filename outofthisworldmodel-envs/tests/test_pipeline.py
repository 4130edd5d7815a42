"""What is read one step ahead comes whole, in order, and never too far ahead."""

import threading
import weakref

import pytest

from owm_envs.pipeline import ahead


@pytest.mark.parametrize("size", [1, 3])
def test_a_slow_reader_gets_everything_and_holds_the_maker_back(size):
    made, read, furthest = [], [], 0

    def items():
        for number in range(50):
            made.append(number)
            yield number

    waiting = threading.Event()
    for number in ahead(items(), size):
        waiting.wait(0.001)  # slower than the maker, who fills the queue meanwhile
        furthest = max(furthest, len(made) - number)
        read.append(number)
    assert read == list(range(50))
    assert 1 < furthest <= size + 2, "those that wait, the one in hand and the one being made"


def test_no_more_items_live_than_are_needed():
    class Frame:
        pass

    alive = weakref.WeakSet()

    def items():
        for _ in range(20):
            frame = Frame()
            alive.add(frame)
            yield frame
            del frame

    most = 0
    for frame in ahead(items()):
        most = max(most, len(alive))
        del frame
    assert most <= 3 and not alive


def test_what_goes_wrong_in_the_maker_is_raised_to_the_reader():
    def items():
        yield 1
        raise ValueError("no more")

    reader = ahead(items())
    assert next(reader) == 1
    with pytest.raises(ValueError, match="no more"):
        next(reader)


def test_a_reader_that_leaves_ends_the_maker():
    ended = []

    def items():
        try:
            number = 0
            while True:
                yield (number := number + 1)
        finally:
            ended.append(True)

    reader = ahead(items())
    assert next(reader) == 1
    reader.close()
    assert ended and not any(thread.name == "ahead" for thread in threading.enumerate())
