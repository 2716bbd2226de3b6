"""The secret of a lease: its agent and the asker agree it, and neither sends it.

Everybody on the network may hear both sides. So each side sends a public half and keeps a private
one: X25519. Every order under the lease carries a proof made with the secret.
"""

from __future__ import annotations

import hashlib
import hmac

from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey, X25519PublicKey

from m100link.apps.agent.lease import Lease
from m100link.apps.agent.remote_error import MessageError
from m100link.apps.fleet.payloads import Order, Reply

_ABOUT = b"m100link lease 2\n"


class Half:
    """The private half of one side, for one order only."""

    def __init__(self) -> None:
        self._key = X25519PrivateKey.generate()
        self.public = self._key.public_key().public_bytes_raw()

    def secret(self, order: Order, theirs: bytes, agents: bytes) -> str:
        """Return the secret of the lease that an order asks for, 64 hexadecimal digits.

        ``theirs``: the public half of the other side, 32 bytes. ``agents``: the public half of the
        agent, 32 bytes.

        Raises:
            MessageError: ``theirs`` is no half of a secret.
        """
        try:
            shared = self._key.exchange(X25519PublicKey.from_public_bytes(theirs))
        except ValueError:
            raise MessageError(
                "whoever asks for a lease sends a public key of X25519, and its agent one back",
                cause=f"{len(theirs)} bytes came that are none",
                remedy="use the same release on both sides",
            ) from None
        return hmac.new(shared, _ABOUT + agents + order.signed(), hashlib.sha256).hexdigest()


def agree(order: Order) -> tuple[bytes, str]:
    """Return the agent's side: its public half, for the reply, and the secret.

    Raises:
        MessageError: The order brings no half.
    """
    half = Half()
    return half.public, half.secret(order, order.key, half.public)


class LeaseRequest:
    """The asker's side."""

    def __init__(self, order: Order, half: Half) -> None:
        self.order, self._half = order, half

    def lease(self, reply: Reply) -> Lease:
        """Return the lease that a reply grants.

        Raises:
            MessageError: The reply brings no half of a secret.
        """
        secret = self._half.secret(self.order, reply.key, reply.key)
        return Lease(reply.text, secret, reply.number)
