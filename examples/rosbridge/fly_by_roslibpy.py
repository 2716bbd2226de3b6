"""Take off, fly two seconds to the east, land: with roslibpy, against `m100link serve --sim`."""

# mypy: ignore-errors
# pyright: reportArgumentType=false, reportCallIssue=false

from __future__ import annotations

import time

import roslibpy


def hear_statuses(connection: roslibpy.comm.RosBridgeProtocol) -> None:
    """The station reports a message that it cannot use by a `status`, left to you."""
    # roslibpy 2.1 keeps an empty place for it, and takes that for taken.
    connection._message_handlers.pop("status", None)
    connection.register_message_handlers(
        "status", lambda status: print(status["level"], status["msg"])
    )


ros = roslibpy.Ros("127.0.0.1", 9090)
ros.factory.on("ready", hear_statuses)  # at each connection: roslibpy connects again by itself
ros.run()


def call(name: str, kind: str, **request: object) -> None:
    service = roslibpy.Service(ros, f"/dji_sdk/{name}", f"dji_sdk/{kind}")
    answer = service.call(roslibpy.ServiceRequest(request), timeout=30)
    print(name, dict(answer))


status: list[int] = []
listener = roslibpy.Topic(ros, "/dji_sdk/flight_status", "std_msgs/UInt8")
listener.subscribe(lambda message: status.append(message["data"]))
call("activation", "Activation")
call("sdk_control_authority", "SDKControlAuthority", control_enable=1)
call("drone_task_control", "DroneTaskControl", task=4)
time.sleep(8)

stick = roslibpy.Topic(
    ros, "/dji_sdk/flight_control_setpoint_ENUvelocity_yawrate", "sensor_msgs/Joy"
)
for _ in range(40):  # a setpoint lasts 0.2 s: who stops sending stops flying
    stick.publish(roslibpy.Message({"axes": [1.0, 0.0, 0.0, 0.0]}))
    time.sleep(0.05)

call("drone_task_control", "DroneTaskControl", task=6)
while status[-1] != 1:
    time.sleep(0.1)
call("sdk_control_authority", "SDKControlAuthority", control_enable=0)
ros.terminate()
