"""Data identifiers and message identifiers as enums.

Made from the tables of the extension; ``pytest tests/test_ids.py`` writes this file anew when they change.
"""

from enum import IntEnum

__all__ = ["Coordinates", "DataId", "MessageId", "Precision"]


class Precision(IntEnum):
    """Number formats: the two low bits of a data identifier (Table 17).

    >>> import xbus
    >>> f"{xbus.DataId.LatLon | xbus.Precision.Fp1632:04X}", xbus.Precision.Fp1632.size
    ('5042', 6)
    """

    Float32 = 0
    Fp1220 = 1
    Fp1632 = 2
    Float64 = 3

    @property
    def size(self) -> int:
        """Bytes of one number."""
        return (4, 4, 6, 8)[self]


class Coordinates(IntEnum):
    """Coordinate systems: bits 2 and 3 of a data identifier (Table 17).

    >>> import xbus
    >>> xbus.read_log("tests/captures/walk.mtb")["quaternion"].coordinates == xbus.Coordinates.ENU.name
    True
    """

    ENU = 0x0
    NED = 0x4
    NWU = 0x8


class DataId(IntEnum):
    """Data identifiers, format bits zero (Table 16).

    >>> import xbus
    >>> f"{xbus.DataId.Quaternion:04X}", xbus.DataId.Quaternion in xbus.read_log("tests/captures/walk.mtb")
    ('2010', True)
    """

    Temperature = 0x0810
    UtcTime = 0x1010
    PacketCounter = 0x1020
    Itow = 0x1030
    GnssAge = 0x1040
    PressureAge = 0x1050
    SampleTimeFine = 0x1060
    SampleTimeCoarse = 0x1070
    FrameRange = 0x1080
    PacketCounter8 = 0x1090
    SampleTime64 = 0x10A0
    PacketCounter32 = 0x10B0
    Quaternion = 0x2010
    RotationMatrix = 0x2020
    EulerAngles = 0x2030
    BaroPressure = 0x3010
    DeltaV = 0x4010
    Acceleration = 0x4020
    FreeAcceleration = 0x4030
    AccelerationHR = 0x4040
    TriggerIn1 = 0x4810
    TriggerIn2 = 0x4820
    TriggerIn3 = 0x4830
    AltitudeMsl = 0x5010
    AltitudeEllipsoid = 0x5020
    PositionEcef = 0x5030
    LatLon = 0x5040
    GnssPvtData = 0x7010
    GnssSatInfo = 0x7020
    GnssPvtPulse = 0x7030
    RateOfTurn = 0x8020
    DeltaQ = 0x8030
    RateOfTurnHR = 0x8040
    GpsDop = 0x8830
    GpsTimeUtc = 0x8880
    RawAccGyrMagTemp = 0xA010
    RawGyroTemp = 0xA020
    RawAcc = 0xA030
    RawGyr = 0xA040
    RawMag = 0xA050
    RawDeltaQ = 0xA060
    RawDeltaV = 0xA070
    RawFloatAccGyrMagTemp = 0xA090
    AnalogIn1 = 0xB010
    AnalogIn2 = 0xB020
    MagneticField = 0xC020
    MagneticFieldCorrected = 0xC030
    AwindaSnapshot = 0xC810
    VelocityXYZ = 0xD010
    StatusByte = 0xE010
    StatusWord = 0xE020
    Rssi = 0xE040
    DeviceId = 0xE080
    LocationId = 0xE090


class MessageId(IntEnum):
    """Message identifiers (section 5.3). A request and its setting share one.

    >>> import xbus
    >>> xbus.encode_frame(xbus.MessageId.GoToConfig).hex(" ")
    'fa ff 30 00 d1'
    """

    ReqDID = 0x00
    DeviceID = 0x01
    InitBus = 0x02
    InitBusResults = 0x03
    ReqPeriod = 0x04
    SetPeriod = 0x04
    ReqPeriodAck = 0x05
    SetPeriodAck = 0x05
    SetBid = 0x06
    SetBidAck = 0x07
    ReqDataLength = 0x0A
    DataLength = 0x0B
    ReqConfiguration = 0x0C
    Configuration = 0x0D
    RestoreFactoryDef = 0x0E
    RestoreFactoryDefAck = 0x0F
    GoToMeasurement = 0x10
    GoToMeasurementAck = 0x11
    ReqFWRev = 0x12
    FirmwareRev = 0x13
    ReqUniqueId = 0x14
    ReqUniqueIdAck = 0x15
    ReqBaudrate = 0x18
    SetBaudrate = 0x18
    ReqBaudrateAck = 0x19
    SetBaudrateAck = 0x19
    ReqProductVariant = 0x1A
    ReqProductVariantAck = 0x1B
    ReqProductCode = 0x1C
    ProductCode = 0x1D
    ReqHardwareVersion = 0x1E
    HardwareVersion = 0x1F
    ReqProcessingFlags = 0x20
    SetProcessingFlags = 0x20
    ProcessingFlagsAck = 0x21
    SetNoRotation = 0x22
    SetNoRotationAck = 0x23
    RunSelftest = 0x24
    SelftestResults = 0x25
    ReqSyncSettings = 0x2C
    SetSyncSettings = 0x2C
    ReqSyncSettingsAck = 0x2D
    SetSyncSettingsAck = 0x2D
    GoToConfig = 0x30
    GoToConfigAck = 0x31
    MTData = 0x32
    ReqData = 0x34
    MTData2 = 0x36
    WakeUp = 0x3E
    WakeUpAck = 0x3F
    Reset = 0x40
    ResetAck = 0x41
    Error = 0x42
    Warning = 0x43
    MasterIndication = 0x46
    ReqOptionFlags = 0x48
    SetOptionFlags = 0x48
    ReqOptionFlagsAck = 0x49
    SetOptionFlagsAck = 0x49
    ReqUTCTime = 0x60
    SetUTCTime = 0x60
    UTCTime = 0x61
    ReqAvailableFilterProfiles = 0x62
    AvailableFilterProfiles = 0x63
    ReqFilterProfile = 0x64
    SetFilterProfile = 0x64
    SetFilterProfileModern = 0x64
    ReqFilterProfileAck = 0x65
    ReqFilterProfileAckModern = 0x65
    SetFilterProfileAck = 0x65
    ReqGravityMagnitude = 0x66
    SetGravityMagnitude = 0x66
    GravityMagnitudeAck = 0x67
    ReqGnssLeverArm = 0x68
    SetGnssLeverArm = 0x68
    ReqGnssLeverArmAck = 0x69
    SetGnssLeverArmAck = 0x69
    ReqMagneticField = 0x6A
    SetMagneticField = 0x6A
    MagneticFieldAck = 0x6B
    ReqReplayMode = 0x6C
    SetReplayMode = 0x6C
    ReplayModeAck = 0x6D
    ReqLatLonAlt = 0x6E
    SetLatLonAlt = 0x6E
    ReqLatLonAltAck = 0x6F
    SetLatLonAltAck = 0x6F
    IccCommand = 0x74
    IccCommandAck = 0x75
    ReqGnssPlatform = 0x76
    SetGnssPlatform = 0x76
    ReqGnssPlatformAck = 0x77
    SetGnssPlatformAck = 0x77
    ReqErrorReport = 0x7E
    ReqErrorReportAck = 0x7F
    ReqHeading = 0x82
    SetHeading = 0x82
    HeadingAck = 0x83
    ReqLocationID = 0x84
    SetLocationID = 0x84
    ReqLocationIDAck = 0x85
    SetLocationIDAck = 0x85
    ReqExtOutputMode = 0x86
    SetExtOutputMode = 0x86
    ExtOutputMode = 0x87
    SetExtOutputModeAck = 0x87
    StoreFilterState = 0x8A
    StoreFilterStateAck = 0x8B
    ReqPortConfig = 0x8C
    SetPortConfig = 0x8C
    PortConfig = 0x8D
    SetPortConfigAck = 0x8D
    ReqStringOutputType = 0x8E
    SetStringOutputType = 0x8E
    ReqStringOutputTypeAck = 0x8F
    SetStringOutputTypeAck = 0x8F
    ReqEmts = 0x90
    EmtsData = 0x91
    UpdateFilterProfile = 0x92
    UpdateFilterProfileAck = 0x93
    RestoreEmts = 0x94
    RestoreEmtsAck = 0x95
    StoreEmts = 0x96
    StoreEmtsAck = 0x97
    UnlockMaintenanceMode = 0x98
    UnlockMaintenanceModeAck = 0x99
    ClockSyncCommand = 0x9A
    ClockSyncCommandAck = 0x9B
    ReqFilterSettings = 0xA0
    SetFilterSettings = 0xA0
    FilterSettingsAck = 0xA1
    ReqAmd = 0xA2
    SetAmd = 0xA2
    AmdAck = 0xA3
    ResetOrientation = 0xA4
    ResetOrientationAck = 0xA5
    ReqGnssStatus = 0xA6
    GnssStatus = 0xA7
    AdjustUTCTime = 0xA8
    AdjustUTCTimeAck = 0xA9
    ReqGnssReceiverSettings = 0xAC
    SetGnssReceiverSettings = 0xAC
    GnssReceiverSettings = 0xAD
    SetGnssReceiverSettingsAck = 0xAD
    UpdateBias = 0xBC
    UpdateBiasAck = 0xBD
    ReqOutputConfiguration = 0xC0
    SetOutputConfiguration = 0xC0
    ReqOutputConfigurationAck = 0xC1
    SetOutputConfigurationAck = 0xC1
    ReqOutputMode = 0xD0
    SetOutputMode = 0xD0
    ReqOutputModeAck = 0xD1
    SetOutputModeAck = 0xD1
    ReqOutputSettings = 0xD2
    SetOutputSettings = 0xD2
    ReqOutputSettingsAck = 0xD3
    SetOutputSettingsAck = 0xD3
    ReqOutputSkipFactor = 0xD4
    SetOutputSkipFactor = 0xD4
    ReqOutputSkipFactorAck = 0xD5
    SetOutputSkipFactorAck = 0xD5
    SetInitialHeading = 0xD6
    SetInitialHeadingAck = 0xD7
    SetSyncOutSettings = 0xD8
    SetSyncOutSettingsAck = 0xD9
    ReqErrorMode = 0xDA
    SetErrorMode = 0xDA
    ReqErrorModeAck = 0xDB
    SetErrorModeAck = 0xDB
    ReqTransmitDelay = 0xDC
    SetTransmitDelay = 0xDC
    ReqTransmitDelayAck = 0xDD
    SetTransmitDelayAck = 0xDD
    SetMfmResults = 0xDE
    SetMfmResultsAck = 0xDF
    ReqObjectAlignment = 0xE0
    SetObjectAlignment = 0xE0
    ObjectAlignmentAck = 0xE1
    ForwardGnssData = 0xE2
    ForwardGnssDataAck = 0xE3
    ReqCanConfig = 0xE6
    SetCanConfig = 0xE6
    CanConfig = 0xE7
    SetCanConfigAck = 0xE7
    ReqCanOutputConfig = 0xE8
    SetCanOutputConfig = 0xE8
    CanOutputConfig = 0xE9
    SetCanOutputConfigAck = 0xE9
    ReqAlignmentRotation = 0xEC
    SetAlignmentRotation = 0xEC
    ReqAlignmentRotationAck = 0xED
    SetAlignmentRotationAck = 0xED
    ExtendedMessageID = 0xEE
    SetDeviceIdContext = 0xFE
    SetDeviceIdContextAck = 0xFF
