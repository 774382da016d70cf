"""What the flight processor finds in its memory at power-up, seen from the host."""

import random

import pytest

from trimtab.firmware_model.storage.flash import Flash
from trimtab.firmware_model.storage.store import MAGIC, ReferenceStore, memory_bytes
from trimtab.protocol import messages as m
from trimtab.protocol.blobs import Kind
from trimtab.protocol.parameters import DEFAULTS
from trimtab.protocol.upload import UploadSender

OTHER = bytes.fromhex("ba9876543210")


def power_cycled(store):
    return ReferenceStore(Flash(bytearray(store.flash.image)))


def set_parameter(session, name, value):
    session.send(m.ParamSet(1, 1, name, value, 9))
    session.run(0.2)


def test_parameters_that_were_set_come_back_after_a_power_cycle(make_session):
    session = make_session(parameters={"HOVER_S": 2.5})
    session.run(0.3)
    set_parameter(session, b"POS_P_N", 4.25)
    set_parameter(session, b"POS_P_E", 1e9)  # refused
    store = power_cycled(session.store)
    assert store.settings.values == {"POS_P_N": 4.25}
    again = make_session(store=store, parameters={"HOVER_S": 1.5})
    assert again.flight.parameters["POS_P_N"] == 4.25
    assert again.flight.parameters["POS_P_E"] == DEFAULTS["POS_P_E"]
    assert again.flight.parameters["HOVER_S"] == 1.5  # never set: the vehicle file's


def test_parameters_that_were_set_for_another_vehicle_are_not_used(make_session):
    store = ReferenceStore()
    store.settings.keep(OTHER, {"POS_P_N": 4.25})
    session = make_session(store=store)
    session.run(0.3)
    assert session.flight.parameters["POS_P_N"] == DEFAULTS["POS_P_N"]
    assert "parameters set for vehicle ba9876543210: not used" in session.texts()
    set_parameter(session, b"POS_P_N", 3.0)
    assert power_cycled(session.store).settings.values == {"POS_P_N": 3.0}


@pytest.mark.parametrize("values", [{"NO_SUCH": 1.0}, {"FENCE_N_MIN": 20.0}])
def test_stored_parameters_that_the_table_no_longer_takes_are_left_out(make_session, values):
    store = ReferenceStore()
    store.settings.keep(bytes.fromhex("0123456789ab"), {"POS_P_N": 4.25, **values})
    session = make_session(store=store)
    session.run(0.1)
    assert session.flight.parameters["POS_P_N"] == DEFAULTS["POS_P_N"]
    assert "memory: parameters changed by the user do not fit" in session.texts()


@pytest.mark.parametrize("beginning", [b"", MAGIC])
def test_damaged_memory_boots_says_so_and_takes_an_upload(make_session, make_blob, beginning):
    garbage = random.Random(len(beginning)).randbytes(memory_bytes())
    store = ReferenceStore(Flash(bytearray(beginning + garbage[len(beginning) :])))
    session = make_session(store=store)
    session.run(0.3)
    assert store.live(Kind.REFERENCE) is None
    assert any(text.startswith("memory") for text in session.texts())
    blob = make_blob()
    assert session.put(blob).state.name == "DONE"
    assert power_cycled(store).live(Kind.REFERENCE) == blob.to_bytes()


def test_staged_blob_is_checked_again_at_power_up_and_can_be_committed(make_session, make_blob):
    session, blob = make_session(), make_blob()
    session.upload = UploadSender(blob.to_bytes(), blob.KIND, commit=False)
    session.run(2.0, until=lambda: session.store.staged(Kind.REFERENCE) is not None)
    stricter = make_session(store=power_cycled(session.store), parameters={"LIM_SPEED": 0.5})
    stricter.run(0.2)
    assert bytes(stricter.received(m.FcStatus)[-1].staged_id) == bytes(6)
    again = make_session(store=power_cycled(session.store))
    again.run(0.2)
    assert bytes(again.received(m.FcStatus)[-1].staged_id).hex() == blob.id
    sender = again.put(blob)
    assert sender.state.name == "DONE"
    assert sender.chunks_sent == 0
    assert again.store.live(Kind.REFERENCE) == blob.to_bytes()
