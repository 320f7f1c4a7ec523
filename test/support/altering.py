"""Recordings told otherwise: rewritten whole by the mcap package's own writer, but for what is altered."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from gear_dynamics_ros.messages.cdr import deserialize, serialize
from gear_dynamics_ros.topics import TOPICS, full_topic_name

Change = Callable[[str, bytes], bytes | None]


def alter(
    source: Path, target: Path, *, attachment: Change | None = None, message: Change | None = None
) -> Path:
    """Copy the recording ``source``, each part through the changes.

    ``attachment`` gets name and content, ``message`` key in TOPICS and CDR; both return what is to stand
    there, None for nothing.
    """
    target.mkdir()
    for path in sorted(source.iterdir()):
        if path.suffix == ".mcap":
            _alter_part(path, target / path.name, attachment or _same, message or _same)
        else:
            shutil.copy(path, target)
    return target


def on_topic(wanted: str, number: int, change: Callable[[Any], object]) -> Change:
    """Change of the message ``number`` on a topic (key in TOPICS): ``change`` alters it in place."""
    seen = 0

    def act(topic: str, data: bytes) -> bytes:
        nonlocal seen
        if topic != wanted:
            return data
        seen += 1
        if seen - 1 != number:
            return data
        message = deserialize(TOPICS[topic].type, data)
        for name, value in vars(message).items():
            if isinstance(value, np.ndarray):
                setattr(message, name, value.copy())  # theirs can't be written to
        change(message)
        return serialize(TOPICS[topic].type, message)

    return act


def in_json(wanted: str, change: Callable[[dict[str, Any]], object]) -> Change:
    """Change of an attachment in JSON: ``change`` alters it in place."""

    def act(name: str, data: bytes) -> bytes:
        if name != wanted:
            return data
        content = json.loads(data)
        change(content)
        return json.dumps(content).encode()

    return act


def _same(_: str, data: bytes) -> bytes:
    return data


def _alter_part(source: Path, target: Path, attachment: Change, message: Change) -> None:
    with source.open("rb") as stream, target.open("xb") as out:
        reader = make_reader(stream)
        summary = reader.get_summary()
        assert summary is not None
        node = next(record for record in reader.iter_metadata() if record.name == "gear_dynamics_ros")
        keys = {full_topic_name(topic, node.metadata["node"]): key for key, topic in TOPICS.items()}
        writer = Writer(out, compression=CompressionType.ZSTD)
        writer.start(profile="ros2", library="altering")
        schemas = {
            number: writer.register_schema(name=schema.name, encoding=schema.encoding, data=schema.data)
            for number, schema in summary.schemas.items()
        }
        channels = {
            number: writer.register_channel(
                topic=channel.topic,
                message_encoding=channel.message_encoding,
                schema_id=schemas[channel.schema_id],
                metadata=channel.metadata,
            )
            for number, channel in summary.channels.items()
        }
        for entry in reader.iter_attachments():
            content = attachment(entry.name, entry.data)
            if content is not None:
                writer.add_attachment(
                    create_time=entry.create_time,
                    log_time=entry.log_time,
                    name=entry.name,
                    media_type=entry.media_type,
                    data=content,
                )
        for record in reader.iter_metadata():
            writer.add_metadata(record.name, record.metadata)
        for _, channel, stored in reader.iter_messages(log_time_order=False):
            data = message(keys[channel.topic], stored.data)
            if data is not None:
                writer.add_message(
                    channel_id=channels[channel.id],
                    log_time=stored.log_time,
                    publish_time=stored.publish_time,
                    sequence=stored.sequence,
                    data=data,
                )
        writer.finish()
