// Reads the values of nodes with their status and the property Reason: node node_opcua_read.js URL NODE...
const opcua = require("node-opcua-client");
const { AttributeIds, MessageSecurityMode, SecurityPolicy } = opcua;
const [url, ...names] = process.argv.slice(2);
(async () => {
  const client = opcua.OPCUAClient.create({
    securityMode: MessageSecurityMode.SignAndEncrypt, securityPolicy: SecurityPolicy.Basic256Sha256,
    endpointMustExist: false, connectionStrategy: { maxRetry: 1 },
  });
  await client.connect(url);
  const session = await client.createSession();
  const found = {};
  for (const name of names) {
    const value = await session.read({ nodeId: `ns=2;s=${name}`, attributeId: AttributeIds.Value });
    const properties = await session.browse({ nodeId: `ns=2;s=${name}`, referenceTypeId: "HasProperty" });
    const reason = properties.references.find((one) => one.browseName.name === "Reason");
    const text = reason ? (await session.read({ nodeId: reason.nodeId, attributeId: AttributeIds.Value })).value.value : null;
    found[name] = [value.value && value.value.value, value.statusCode.name, text];
  }
  console.log(JSON.stringify(found));
  await session.close();
  await client.disconnect();
  process.exit(0);
})().catch((error) => { console.error(error); process.exit(1); });
