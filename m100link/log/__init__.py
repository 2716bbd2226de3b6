"""Flight logs: one MCAP file per connection, with every byte of it and its meaning.

Needs the extra ``log``. Foxglove and Lichtblick open the files; :func:`read` reads them back.
"""

from m100link.log.damage import Damage
from m100link.log.reading import Chunk, FlightLog, Message, Summary, read, recover
from m100link.log.recorder import Recorder

__all__ = ["Chunk", "Damage", "FlightLog", "Message", "Recorder", "Summary", "read", "recover"]
