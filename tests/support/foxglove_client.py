"""A client of Foxglove's websocket protocol (foxglove.sdk.v1): it subscribes to all channels and decodes messages."""

import json
import struct
from collections.abc import Iterator

import websocket
from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory

MESSAGE = 0x01  # opcode of a binary frame: u8, u32 subscription, u64 time in ns, payload


class FoxgloveClient:
    """channels: {topic: channel} as the server advertised them."""

    def __init__(self, url: str, timeout: float):
        self.socket = websocket.create_connection(url, subprotocols=["foxglove.sdk.v1"], timeout=timeout)
        self.channels: dict[str, dict] = {}
        self.status: list[str] = []
        self.decoders: dict[int, tuple] = {}

    def messages(self) -> Iterator[tuple[str, int, object]]:
        """(topic, time in ns, decoded message) until the server closes the connection."""
        while True:
            try:
                code, content = self.socket.recv_data()
            except (websocket.WebSocketConnectionClosedException, ConnectionError):
                return
            if code == websocket.ABNF.OPCODE_CLOSE:
                return
            if code == websocket.ABNF.OPCODE_TEXT:
                self.hear(json.loads(content))
            elif content[0] == MESSAGE:
                subscription, time = struct.unpack_from("<IQ", content, 1)
                topic, decode = self.decoders[subscription]
                yield topic, time, decode(content[13:])

    def hear(self, said: dict) -> None:
        """Subscribe to advertised channels, and keep status messages."""
        if said["op"] == "status":
            self.status.append(said["message"])
        for channel in said.get("channels", []) if said["op"] == "advertise" else []:
            self.channels[channel["topic"]] = channel
            name = channel["schemaName"]
            schema = Schema(id=channel["id"], name=name, encoding="ros2msg", data=channel["schema"].encode())
            self.decoders[channel["id"]] = channel["topic"], DecoderFactory().decoder_for("cdr", schema)
            expected = [{"id": channel["id"], "channelId": channel["id"]}]
            self.socket.send(json.dumps({"op": "subscribe", "subscriptions": expected}))

    def close(self) -> None:
        """Close the connection."""
        self.socket.close()
