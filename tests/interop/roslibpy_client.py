"""What a program with roslibpy sees of a station; prints one line of JSON."""

# mypy: ignore-errors
# pyright: reportArgumentType=false, reportCallIssue=false
# ruff: noqa: T201
from __future__ import annotations

import json
import sys
import time
from typing import Any

import roslibpy


def main(host: str, port: int) -> None:
    ros = roslibpy.Ros(host, port)
    statuses: list[Any] = []

    def hear_statuses(connection: Any) -> None:
        """As in docs/howto/ground-station.md."""
        connection._message_handlers.pop("status", None)
        connection.register_message_handlers("status", statuses.append)

    ros.factory.on("ready", hear_statuses)
    ros.run(timeout=120)
    seen: dict[str, Any] = {"connected": ros.is_connected, "topics": ros.get_topics()}
    seen["type"] = ros.get_topic_type("/dji_sdk/imu")
    seen["services"] = ros.get_services()
    attitudes: list[Any] = []
    listener = roslibpy.Topic(
        ros, "/dji_sdk/attitude", "geometry_msgs/QuaternionStamped", throttle_rate=100
    )
    listener.subscribe(attitudes.append)
    deadline = time.monotonic() + 120
    while len(attitudes) < 20 and time.monotonic() < deadline:
        time.sleep(0.1)
    listener.unsubscribe()
    # By their own times: those of this program are the machine's.
    stamps = [one["header"]["stamp"] for one in attitudes]
    times = [stamp["secs"] + stamp["nsecs"] / 1e9 for stamp in stamps]
    seen["attitude_rate"] = (len(times) - 1) / (times[-1] - times[0])
    seen["attitude"] = attitudes[-1]

    def call(name: str, kind: str, **request: Any) -> Any:
        service = roslibpy.Service(ros, name, kind)
        return dict(service.call(roslibpy.ServiceRequest(request), timeout=120))

    seen["activation"] = call("/dji_sdk/activation", "dji_sdk/Activation")
    seen["authority"] = call(
        "/dji_sdk/sdk_control_authority", "dji_sdk/SDKControlAuthority", control_enable=1
    )
    try:
        call("/nothing", "std_srvs/Empty")
    except Exception as error:  # noqa: BLE001 - its type is what roslibpy makes of it
        seen["wrong_service"] = str(error)
    # Nobody can publish there: a status reports it, and the connection goes on.
    roslibpy.Topic(ros, "/no_such_topic", "std_msgs/UInt8").publish(roslibpy.Message({"data": 1}))
    phases: list[float] = []
    status = roslibpy.Topic(ros, "/flight_status", "std_msgs/Float32")
    status.subscribe(lambda message: phases.append(message["data"]))
    command = roslibpy.Topic(ros, "/sdk_request_cmd", "std_msgs/Float32")
    command.advertise()
    command.publish(roslibpy.Message({"data": 4.0}))
    deadline = time.monotonic() + 120
    while 3.0 not in phases and time.monotonic() < deadline:
        time.sleep(0.1)
    seen["phases"] = sorted(set(phases))
    command.unadvertise()
    status.unsubscribe()
    seen["statuses"] = [dict(status) for status in statuses]
    print(json.dumps(seen))
    sys.stdout.flush()
    ros.terminate()


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]))
