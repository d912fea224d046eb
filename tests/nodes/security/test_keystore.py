"""A keystore as sros2 lays it out, whose signatures and certificates openssl accepts."""

import shutil
import subprocess
from xml.etree import ElementTree

import pytest

pytest.importorskip("cryptography")

from ptnsbc_nodes.security.keystore import KeystoreError, write_keystore
from ptnsbc_nodes.security.permissions import Permission

_NAMES = ("cert.pem", "key.pem", "identity_ca.cert.pem", "permissions_ca.cert.pem")
_DOCUMENTS = ("governance.p7s", "permissions.p7s", "permissions.xml")
UAV = Permission("/blue/uav1", ["rt/blue/uav1/formation_state"], ["rt/blue/formation/epoch"])


def openssl(*words):
    return subprocess.run(
        ["openssl", *map(str, words)], capture_output=True, text=True, check=False
    )


@pytest.fixture
def keystore(tmp_path):
    write_keystore(tmp_path / "keys", [UAV, Permission("/fleet")])
    return tmp_path / "keys"


def test_each_identity_has_what_rcl_looks_for(keystore):
    for enclave in ("blue/uav1", "fleet"):
        folder = keystore / "enclaves" / enclave
        assert {path.name for path in folder.iterdir()} == {*_NAMES, *_DOCUMENTS}
        for path in folder.iterdir():
            assert path.read_bytes()  # no link leads nowhere
        assert (folder / "key.pem").stat().st_mode & 0o077 == 0
    assert (keystore / "private").stat().st_mode & 0o077 == 0
    # Copied to another place it is the same keystore.
    shutil.copytree(keystore, keystore.with_name("copy"), symlinks=True)
    for path in (keystore.with_name("copy") / "enclaves/fleet").iterdir():
        assert path.resolve().is_relative_to(keystore.with_name("copy").resolve())


# Another program judges than the one that wrote them; .ci/run installs it.
@pytest.mark.skipif(shutil.which("openssl") is None, reason="openssl is not installed")
def test_openssl_accepts_certificates_and_signatures(keystore):
    authority = keystore / "public" / "ca.cert.pem"
    own = keystore / "enclaves" / "blue" / "uav1"
    assert openssl("verify", "-CAfile", authority, own / "cert.pem").returncode == 0
    for name in ("permissions", "governance"):
        signed = ("smime", "-verify", "-CAfile", authority, "-text", "-in", own / f"{name}.p7s")
        told = openssl(*signed)
        assert told.returncode == 0, told.stderr
        assert ElementTree.fromstring(told.stdout.encode()).tag == "dds"
    forged = (own / "permissions.p7s").read_text().replace("uav1/formation_state", "uav2/odom")
    (own / "forged.p7s").write_text(forged)
    assert openssl("smime", "-verify", "-CAfile", authority, "-in", own / "forged.p7s").returncode


def test_the_grant_is_for_its_owner_and_denies_the_rest(keystore):
    grant = ElementTree.parse(keystore / "enclaves/blue/uav1/permissions.xml").find("*/grant")
    assert grant.findtext("subject_name") == "CN=/blue/uav1"
    assert grant.findtext("default") == "DENY"
    rule = grant.find("allow_rule")
    assert [one.text for one in rule.findall("publish/topics/topic")] == UAV.publish
    assert [one.text for one in rule.findall("subscribe/topics/topic")] == UAV.subscribe


def test_only_one_domain_when_one_is_named(tmp_path):
    write_keystore(tmp_path / "keys", [UAV], domain=42)
    for name in ("governance.xml", "blue/uav1/permissions.xml"):
        root = ElementTree.parse(tmp_path / "keys/enclaves" / name).getroot()
        assert [one.text for one in root.iter("id")] == ["42"]


def test_a_second_time_identities_stay_and_permissions_are_renewed(keystore):
    own = keystore / "enclaves" / "blue" / "uav1"
    kept = {name: (own / name).read_bytes() for name in ("key.pem", "cert.pem")}
    authority = (keystore / "public/ca.cert.pem").read_bytes()
    more = Permission(UAV.enclave, ["rt/blue/uav1/tick"], [])
    write_keystore(keystore, [more, Permission("/blue/uav2")])
    assert {name: (own / name).read_bytes() for name in kept} == kept
    assert (keystore / "public/ca.cert.pem").read_bytes() == authority
    assert "uav1/tick" in (own / "permissions.xml").read_text()
    assert (keystore / "enclaves/blue/uav2/cert.pem").exists()


def test_a_folder_that_is_none_is_left_alone(tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(KeystoreError, match="expected a new or empty folder"):
        write_keystore(tmp_path, [UAV])
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]


@pytest.mark.parametrize(("name", "words"), [("key", "no private key"), ("cert", "no certificate")])
def test_a_damaged_authority_is_named(keystore, name, words):
    path = keystore / ("private/ca.key.pem" if name == "key" else "public/ca.cert.pem")
    path.write_text("nonsense")
    with pytest.raises(KeystoreError, match=words):
        write_keystore(keystore, [UAV])
