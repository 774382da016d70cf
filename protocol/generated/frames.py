"""What finds messages in a byte stream. Made by `python -m protocol.generate`."""

DIALECT_VERSION = 1

# id: (name, checksum seed, longest payload in bytes)
MESSAGES: dict[int, tuple[str, int, int]] = {
    0: ("HEARTBEAT", 50, 9),
    4: ("PING", 237, 14),
    20: ("PARAM_REQUEST_READ", 214, 20),
    21: ("PARAM_REQUEST_LIST", 159, 2),
    22: ("PARAM_VALUE", 220, 25),
    23: ("PARAM_SET", 168, 23),
    76: ("COMMAND_LONG", 152, 33),
    77: ("COMMAND_ACK", 143, 10),
    111: ("TIMESYNC", 34, 16),
    138: ("ATT_POS_MOCAP", 109, 120),
    148: ("AUTOPILOT_VERSION", 178, 78),
    253: ("STATUSTEXT", 83, 54),
    52100: ("FC_CONTROL", 18, 84),
    52101: ("FC_ESTIMATE", 35, 62),
    52102: ("FC_STATUS", 103, 61),
    52103: ("RADIO_STATS", 151, 20),
    52104: ("FC_OBSERVER", 140, 16),
    52110: ("UPLOAD_BEGIN", 112, 39),
    52111: ("UPLOAD_CHUNK", 128, 104),
    52112: ("UPLOAD_STATUS", 143, 73),
    52113: ("UPLOAD_VERDICT", 107, 78),
    52114: ("UPLOAD_COMMIT", 157, 34),
    52115: ("UPLOAD_ABORT", 57, 33),
}
