"""Predictions of `gelforge live` as messages of ROS 2: served to Foxglove, recorded as MCAP, or both."""

import threading
from argparse import Namespace
from collections.abc import Iterable
from contextlib import ExitStack

from gelforge.commands.live_readings import is_lost, lost, readings, until
from gelforge.errors import BadInput
from gelforge.live.foxglove import FoxgloveServer
from gelforge.live.reading import Reading
from gelforge.live.recording import McapRecorder
from gelforge.live.topics import RosMessages
from gelforge.records.film import Film


def show_topics(args: Namespace, predictor, frames, film: Film, name: str, over: threading.Event) -> None:
    """Serve messages until `over` is set, and record them until the frames end.

    BadInput at the end where the frames ended before they should, or the recording was lost; viewers see it at once.
    """
    with ExitStack() as stack:
        topics = RosMessages(args.sensor or (args.profile.stem if args.profile else "gelforge"))
        server, recorder = opened(args, name, stack)
        found = readings(predictor, until(over, frames), paced=bool(server) and not film.camera)
        count, fault = send(found, topics, server, recorder)
        if is_lost(args, over, film):
            fault = fault or BadInput(lost(name, film.taken))
        if recorder and recorder.on:
            recorder.stop()
            print(f"{recorder.file(recorder.name)}: {count} frames", flush=True)
        if server:
            server.announce(str(fault or f"{name}: ended after {count} frames"))
            over.wait()  # viewers keep what they have
        if fault:
            raise fault


def opened(args: Namespace, name: str, stack: ExitStack) -> tuple[FoxgloveServer | None, McapRecorder | None]:
    """The server and the recorder that were asked for, which the stack ends."""
    server = recorder = None
    if args.foxglove:
        server = FoxgloveServer(args.host, args.port)
        stack.callback(server.stop)
        print(f"{server.url} shows {name} to Foxglove (Open connection); Ctrl-C ends", flush=True)
    if args.record:
        recorder = McapRecorder(args.record)
        recorder.start()
        stack.callback(recorder.drop)
    return server, recorder


def send(
    found: Iterable[Reading], topics: RosMessages, server: FoxgloveServer | None, recorder: McapRecorder | None
) -> tuple[int, BadInput | None]:
    """Send readings until they end: how many they were, and what went wrong. Where there are viewers they go on without a recording."""
    count, fault = 0, None
    try:
        for reading in found:
            time, messages = topics(reading)
            if server:
                server.send(time, messages)
            if recorder and recorder.on:
                try:
                    recorder.add((time, messages))
                except BadInput as error:
                    if not server:
                        raise
                    fault = error
                    server.announce(str(error))
            count += 1
    except BadInput as error:
        fault = error
    return count, fault
