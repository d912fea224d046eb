"""The keystore of DDS Security, laid out as sros2 does it: a certificate authority, a governance, and an identity with
signed permissions for each process (OMG DDS Security 1.1, sections 9.3 and 9.4).
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from datetime import datetime, timedelta, timezone
from pathlib import Path
from xml.etree import ElementTree

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import pkcs7
from cryptography.x509.oid import NameOID

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_nodes.security.permissions import Permission

_VALID_DAYS = 3650  # as sros2: a fleet must not be grounded by a date that no one remembers
_AUTHORITY = "ptnsbc CA"
_SCHEMAS = "http://www.omg.org/spec/DDS-SECURITY/20170901/omg_shared_ca"
_XSI = "http://www.w3.org/2001/XMLSchema-instance"
# Both the identities and the permissions are signed by one authority.
_PURPOSES = ("identity_ca", "permissions_ca")


class KeystoreError(PtnsbcError):
    """A folder that is no keystore, or one whose authority cannot be used."""


def write_keystore(folder: Path, granted: Iterable[Permission], domain: int | None = None) -> None:
    """Write a keystore, or renew the permissions of the one that is there and add what is missing.

    Args:
        folder: Of the keystore, for `ROS_SECURITY_KEYSTORE`.
        granted: What each process may do.
        domain: The only ROS domain in which it may; any by default.

    Raises:
        KeystoreError: the folder holds something else, or an authority without its key.
    """
    authority = _Authority.of(folder)
    enclaves = folder / "enclaves"
    governance = _governance(domain)
    _write(enclaves / "governance.xml", governance)
    _write(enclaves / "governance.p7s", authority.signed(governance))
    for permission in granted:
        own = enclaves / permission.enclave.strip("/")
        own.mkdir(parents=True, exist_ok=True)
        for purpose in _PURPOSES:
            _link(own / f"{purpose}.cert.pem", folder / "public" / f"{purpose}.cert.pem")
        _link(own / "governance.p7s", enclaves / "governance.p7s")
        certificate = authority.identity(own, permission.enclave)
        xml = _permissions(permission, certificate, domain)
        _write(own / "permissions.xml", xml)
        _write(own / "permissions.p7s", authority.signed(xml))


class _Authority:
    """The certificate authority of one keystore."""

    def __init__(self, key: ec.EllipticCurvePrivateKey, certificate: x509.Certificate) -> None:
        self._key, self._certificate = key, certificate

    @classmethod
    def of(cls, folder: Path) -> _Authority:
        """The one that is there, or a new one."""
        public, private = folder / "public", folder / "private"
        key_file, certificate_file = private / "ca.key.pem", public / "ca.cert.pem"
        if key_file.exists() and certificate_file.exists():
            return cls(_read_key(key_file), _read_certificate(certificate_file))
        if folder.exists() and any(folder.iterdir()):
            raise KeystoreError(
                f"{folder}: expected a new or empty folder, or a keystore with private/ca.key.pem"
            )
        for part in (public, private, folder / "enclaves"):
            part.mkdir(parents=True, exist_ok=True)
        private.chmod(0o700)
        key = ec.generate_private_key(ec.SECP256R1())
        certificate = _certificate(
            _name(_AUTHORITY), key, _name(_AUTHORITY), key, is_authority=True
        )
        _write(key_file, _pem(key), secret=True)
        _write(certificate_file, certificate.public_bytes(serialization.Encoding.PEM))
        for purpose in _PURPOSES:
            _link(public / f"{purpose}.cert.pem", certificate_file)
            _link(private / f"{purpose}.key.pem", key_file)
        return cls(key, certificate)

    def identity(self, folder: Path, enclave: str) -> x509.Certificate:
        """The certificate of an enclave, a new one if there is none."""
        key_file, certificate_file = folder / "key.pem", folder / "cert.pem"
        if key_file.exists() and certificate_file.exists():
            return _read_certificate(certificate_file)
        key = ec.generate_private_key(ec.SECP256R1())
        certificate = _certificate(
            _name(enclave), key, self._certificate.subject, self._key, is_authority=False
        )
        _write(key_file, _pem(key), secret=True)
        _write(certificate_file, certificate.public_bytes(serialization.Encoding.PEM))
        return certificate

    def signed(self, document: bytes) -> bytes:
        """The document with its signature, as S/MIME."""
        builder = pkcs7.PKCS7SignatureBuilder().set_data(document)
        builder = builder.add_signer(self._certificate, self._key, hashes.SHA256())
        options = [pkcs7.PKCS7Options.Text, pkcs7.PKCS7Options.DetachedSignature]
        return builder.sign(serialization.Encoding.SMIME, options)


def _certificate(
    subject: x509.Name,
    key: ec.EllipticCurvePrivateKey,
    issuer: x509.Name,
    issuers_key: ec.EllipticCurvePrivateKey,
    *,
    is_authority: bool,
) -> x509.Certificate:
    now = datetime.now(timezone.utc)
    length = 1 if is_authority else None
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - timedelta(days=1))  # the clock of a vehicle may be behind ours
        .not_valid_after(now + timedelta(days=_VALID_DAYS))
        .add_extension(x509.BasicConstraints(is_authority, length), critical=is_authority)
        .sign(issuers_key, hashes.SHA256())
    )


def _governance(domain: int | None) -> bytes:
    """Everybody proves who they are, contents are encrypted, and permissions count for every topic.

    Each sender signs its messages with a key of its own. sros2 encrypts them as a whole besides and signs the packet
    that they travel in, which takes a sixth more processor time and hides no more of their contents.
    """
    root = _document("governance")
    rule = ElementTree.SubElement(
        ElementTree.SubElement(root, "domain_access_rules"), "domain_rule"
    )
    _domains(rule, domain)
    for name, value in (
        ("allow_unauthenticated_participants", "false"),
        ("enable_join_access_control", "true"),
        ("discovery_protection_kind", "ENCRYPT"),
        ("liveliness_protection_kind", "ENCRYPT"),
        ("rtps_protection_kind", "NONE"),
    ):
        ElementTree.SubElement(rule, name).text = value
    topic = ElementTree.SubElement(ElementTree.SubElement(rule, "topic_access_rules"), "topic_rule")
    for name, value in (
        ("topic_expression", "*"),
        ("enable_discovery_protection", "true"),
        ("enable_liveliness_protection", "true"),
        ("enable_read_access_control", "true"),
        ("enable_write_access_control", "true"),
        ("metadata_protection_kind", "SIGN"),
        ("data_protection_kind", "ENCRYPT"),
    ):
        ElementTree.SubElement(topic, name).text = value
    return _text(root)


def _permissions(
    permission: Permission, certificate: x509.Certificate, domain: int | None
) -> bytes:
    root = _document("permissions")
    grants = ElementTree.SubElement(root, "permissions")
    grant = ElementTree.SubElement(grants, "grant", name=permission.enclave)
    subject = certificate.subject.rfc4514_string()
    ElementTree.SubElement(grant, "subject_name").text = subject
    validity = ElementTree.SubElement(grant, "validity")
    for name, when in (
        ("not_before", certificate.not_valid_before_utc),
        ("not_after", certificate.not_valid_after_utc),
    ):
        ElementTree.SubElement(validity, name).text = when.strftime("%Y-%m-%dT%H:%M:%S")
    rule = ElementTree.SubElement(grant, "allow_rule")
    _domains(rule, domain)
    for name, names in (("publish", permission.publish), ("subscribe", permission.subscribe)):
        topics = ElementTree.SubElement(ElementTree.SubElement(rule, name), "topics")
        for one in sorted(set(names)):
            ElementTree.SubElement(topics, "topic").text = one
    ElementTree.SubElement(grant, "default").text = "DENY"
    return _text(root)


def _domains(rule: ElementTree.Element, domain: int | None) -> None:
    domains = ElementTree.SubElement(rule, "domains")
    if domain is not None:
        ElementTree.SubElement(domains, "id").text = str(domain)
        return
    ids = ElementTree.SubElement(domains, "id_range")
    ElementTree.SubElement(ids, "min").text = "0"
    ElementTree.SubElement(ids, "max").text = "232"


def _document(kind: str) -> ElementTree.Element:
    ElementTree.register_namespace("xsi", _XSI)
    return ElementTree.Element(
        "dds", {f"{{{_XSI}}}noNamespaceSchemaLocation": f"{_SCHEMAS}_{kind}.xsd"}
    )


def _text(root: ElementTree.Element) -> bytes:
    ElementTree.indent(root)
    text: bytes = ElementTree.tostring(root, encoding="UTF-8", xml_declaration=True)
    return text + b"\n"


def _name(common: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common)])


def _pem(key: ec.EllipticCurvePrivateKey) -> bytes:
    return key.private_bytes(
        serialization.Encoding.PEM,
        serialization.PrivateFormat.PKCS8,
        serialization.NoEncryption(),
    )


def _read_key(path: Path) -> ec.EllipticCurvePrivateKey:
    try:
        key = serialization.load_pem_private_key(path.read_bytes(), None)
    except (OSError, ValueError, TypeError) as error:
        raise KeystoreError(f"{path}: no private key: {error}") from None
    if not isinstance(key, ec.EllipticCurvePrivateKey):
        raise KeystoreError(f"{path}: expected a key on an elliptic curve, as DDS Security demands")
    return key


def _read_certificate(path: Path) -> x509.Certificate:
    try:
        return x509.load_pem_x509_certificate(path.read_bytes())
    except (OSError, ValueError) as error:
        raise KeystoreError(f"{path}: no certificate: {error}") from None


def _write(path: Path, data: bytes, *, secret: bool = False) -> None:
    beside = path.with_name(f"{path.name}.part")
    descriptor = os.open(beside, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600 if secret else 0o644)
    with os.fdopen(descriptor, "wb") as file:
        file.write(data)
    beside.replace(path)


def _link(path: Path, target: Path) -> None:
    """A relative link, so that the keystore can be copied."""
    if not path.is_symlink():
        path.symlink_to(os.path.relpath(target, path.parent))
