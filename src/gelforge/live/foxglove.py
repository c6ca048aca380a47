"""A server of ROS 2 messages for Foxglove, in its websocket protocol, with Foxglove's library."""

import sys
from collections import defaultdict
from typing import Any

from gelforge.errors import BadInput
from gelforge.formats.export import ros
from gelforge.live.reading import Reading
from gelforge.live.topics import RosMessages


class FoxgloveServer:
    """Serves messages to any number of viewers; a slow viewer loses its oldest messages.

    BadInput where the port cannot be served.
    """

    def __init__(self, host: str, port: int, messages: RosMessages):
        import foxglove

        self.messages = messages
        self.context = foxglove.Context()
        self.channels: dict[str, foxglove.Channel] = {}
        viewers: Any = Viewers()  # has only the listener's methods that are called if clients may only subscribe
        try:
            self.server = foxglove.start_server(
                name="gelforge", host=host, port=port, context=self.context, server_listener=viewers
            )
        except (RuntimeError, OSError, OverflowError) as error:  # the last for a port number out of range
            raise BadInput(f"port {port} of {host}: cannot be served ({error}); name another with --port") from error
        self.url = f"ws://{host}:{self.server.port}"

    def send(self, reading: Reading) -> None:
        """Send the messages of a reading."""
        stamp, messages = self.messages(reading)
        for topic, said in messages:
            self._channel(topic, said.__msgtype__).log(ros.encode(said), log_time=stamp)

    def _channel(self, topic: str, kind: str):
        import foxglove

        if topic not in self.channels:
            schema = foxglove.Schema(name=kind, encoding="ros2msg", data=ros.schema(kind).encode())
            self.channels[topic] = foxglove.Channel(
                topic, message_encoding="cdr", schema=schema, context=self.context
            )
        return self.channels[topic]

    def announce(self, sentence: str, fault: bool = False) -> None:
        """Show a sentence to all viewers."""
        from foxglove import StatusLevel

        self.server.publish_status(sentence, StatusLevel.Warning if fault else StatusLevel.Info)

    def stop(self) -> None:
        """Stop the server; viewers are disconnected."""
        self.server.stop()


class Viewers:
    """Reports on the terminal when viewers come and leave; called from the server's threads."""

    def __init__(self):
        self.topics: dict[int, set[int]] = defaultdict(set)

    def on_subscribe(self, client, channel) -> None:
        if not self.topics[client.id]:
            print(f"viewer {client.id} watches", file=sys.stderr, flush=True)
        self.topics[client.id].add(channel.id)

    def on_unsubscribe(self, client, channel) -> None:
        self.topics[client.id].discard(channel.id)
        if not self.topics[client.id]:
            print(f"viewer {client.id} left; the others go on", file=sys.stderr, flush=True)
