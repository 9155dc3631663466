"""Transactions of confirmed requests: each is answered, also if it cannot be decoded or there are too many."""

from __future__ import annotations

from typing import Any

from bacpypes3.apdu import (
    APDU,
    AbortPDU,
    AbortReason,
    APCISequence,
    ComplexAckPDU,
    ConfirmedRequestPDU,
    ErrorPDU,
    RejectPDU,
    confirmed_request_types,
)
from bacpypes3.appservice import ApplicationServiceAccessPoint, ServerSSM
from bacpypes3.errors import RejectException

from zenostat.gateways.bacnet.counts import BacnetCounts

MAX_TRANSACTIONS = 128
"""Largest number of confirmed requests in progress; further ones are aborted with `out-of-resources`."""

_MAX_SEGMENTS = 64
_HEADER, _SEGMENT_HEADER = 3, 5
"""Octets of a complex acknowledgement before its data, and of a segment of one; ASHRAE 135, clause 20.1.5."""
_CONFIRMED_REQUEST = 0  # type of an APDU, in the upper four bits of its first octet


class Transaction(ServerSSM):
    """A confirmed request; bacpypes3's own leaves requests that it cannot decode without an answer."""

    _segments = 1

    async def request(self, apdu: Any) -> None:
        """Decode a complete request and hand it to the application."""
        if isinstance(apdu, AbortPDU):
            return  # the client's, or of a timeout: the application has nothing to undo
        if apdu.apduService not in confirmed_request_types:
            await self._reject(apdu, "unrecognizedService")
            return
        try:
            request = APCISequence.decode(apdu)
        except RejectException as error:
            await self._reject(apdu, error.rejectReason or "other")
            return
        except Exception:  # whatever its decoders raise at malformed data
            await self._reject(apdu, "invalidTag")
            return
        request.pduSource, request.pduDestination = self.pdu_address, None
        await self.ssmSAP.sap_request(request)

    async def confirmation(self, apdu: Any) -> None:
        """Send the application's answer, in segments if it is too long for the client.

        bacpypes3 cuts the data into segments as long as the longest APDU, whose header comes in addition.
        """
        if isinstance(apdu, ComplexAckPDU):
            longest: int = self.maxApduLengthAccepted  # type: ignore[has-type]
            if self.device_info is not None and self.device_info.max_npdu_length is not None:
                longest = min(longest, self.device_info.max_npdu_length)
            is_whole = len(apdu.pduData) <= longest - _HEADER
            self.maxApduLengthAccepted = longest - (_HEADER if is_whole else _SEGMENT_HEADER)
        await super().confirmation(apdu)

    async def _reject(self, apdu: Any, reason: str) -> None:
        reply = RejectPDU(reason=reason, context=apdu)
        reply.apduInvokeID = self.invokeID
        reply.pduDestination = self.pdu_address
        await self.ssmSAP.sap_confirmation(reply)

    async def segmented_request(self, apdu: Any) -> None:
        """Process a further segment; a request with too many is aborted."""
        self._segments += 1
        if self._segments > _MAX_SEGMENTS:
            await self.response(self.abort(AbortReason.bufferOverflow))
            return
        await super().segmented_request(apdu)

    async def await_response_timeout(self) -> None:
        """Abort a request that the application has not answered in time."""
        await self.response(self.abort(AbortReason.applicationExceededReplyTime))


class TransactionServer(ApplicationServiceAccessPoint):
    """The service access point of the application.

    Args:
        device: the device object.
        device_info_cache: bacpypes3's information about clients.
        counts: counts of messages.
    """

    def __init__(self, device: Any, device_info_cache: Any, counts: BacnetCounts) -> None:
        super().__init__(device, device_info_cache)
        self._counts = counts
        self.segmentationSupported = device.segmentationSupported
        self.maxApduLengthAccepted = device.maxApduLengthAccepted
        self.maxSegmentsAccepted = device.maxSegmentsAccepted

    async def confirmation(self, pdu: Any) -> None:
        """Process an APDU from the network."""
        if not pdu.pduData or pdu.pduData[0] >> 4 != _CONFIRMED_REQUEST:
            await super().confirmation(pdu)
            return
        apdu = APDU.decode(pdu)
        transaction = self._transaction(apdu)
        if transaction is None:
            transaction = Transaction(self, apdu.pduSource)
            if len(self.serverTransactions) >= MAX_TRANSACTIONS:
                self._counts.rejected += 1
                abort = AbortPDU(srv=True, invoke_id=apdu.apduInvokeID, reason=AbortReason.outOfResources)
                await transaction.response(abort)
                return
            self._counts.requests += 1
            self.serverTransactions.append(transaction)
        await transaction.indication(apdu)

    def _transaction(self, apdu: ConfirmedRequestPDU) -> Transaction | None:
        for transaction in self.serverTransactions:
            if transaction.invokeID == apdu.apduInvokeID and transaction.pdu_address == apdu.pduSource:
                return transaction  # type: ignore[no-any-return]
        return None

    async def sap_confirmation(self, apdu: Any) -> None:
        """Send the application's answer."""
        if isinstance(apdu, (ErrorPDU, RejectPDU, AbortPDU)):
            self._counts.rejected += 1
        await super().sap_confirmation(apdu)

    def close(self) -> None:
        """End the timers of all transactions."""
        for transaction in [*self.serverTransactions, *self.clientTransactions]:
            transaction.stop_timer()
